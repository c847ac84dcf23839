import math
from pathlib import Path

import draw_story as story

from clustermcl.evaluation.measures import pose_error

PICTURE = Path(__file__).parents[2] / "docs" / "story.webp"

CABINET_AT = 140
"""By this step the robot of the picture has not seen the cabinet; see `PLAYED_FROM`."""


def test_the_picture_of_the_readme_still_tells_its_story() -> None:
    """Ordinary MCL is sure of a wrong place to the end; ours keeps all four, and decides."""
    theirs, ours = (list(story.run(algorithm)) for algorithm in story.COMPARED)
    sure_and_wrong = [[], []]
    for found, steps in zip(sure_and_wrong, (theirs, ours), strict=True):
        for scan, outcome, truth in steps:
            best = outcome.hypotheses[0]
            if best.probability >= 0.9 and not pose_error(best.pose, truth).right:
                found.append(scan.step)
    assert len(sure_and_wrong[0]) > 0.9 * story.STEPS
    assert sure_and_wrong[0][-1] == story.STEPS - 1
    assert sure_and_wrong[1] == []
    for _, outcome, _ in ours[20:CABINET_AT:20]:
        shares = sorted(place.probability for place in outcome.hypotheses)[-4:]
        assert len(shares) == 4
        assert min(shares) > 0.15
    _, outcome, truth = ours[-1]
    assert outcome.state == "localized"
    assert math.dist(outcome.hypotheses[0].pose[:2], truth[:2]) < 0.5
    assert PICTURE.stat().st_size < 2_000_000
