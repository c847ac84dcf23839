from clustermcl.story import Story
from tests.unit.clustermcl.places import belief, place


def test_a_story_tells_what_was_held_and_when_one_place_won() -> None:
    story = Story()
    story.take(belief(0, "searching"))
    for step in (1, 2):
        story.take(belief(step, "ambiguous", place(0.5), place(0.3), place(0.19), place(0.01)))
    for step in (3, 4, 5):
        story.take(belief(step, "localized", place(0.97), place(0.03)))
    assert list(story.lines()) == [
        "The search found its first places at step 1.",
        "For 2 steps up to 3 places were held, with probabilities from 0.19 to 0.50.",
        "From step 3 on one of them was the pose.",
    ]
    assert story.localized_steps == 3


def test_a_doubt_begins_the_count_of_localized_steps_anew() -> None:
    story = Story()
    for step in range(5):
        story.take(belief(step, "ambiguous" if step == 2 else "localized", place(0.9)))
    assert story.localized_steps == 2


def test_a_story_without_a_step_tells_nothing() -> None:
    story = Story()
    assert list(story.lines()) == []
    assert story.localized_steps == 0
