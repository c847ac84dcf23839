"""Each cluster has a colour of its own for as long as it lives."""

from hypothesis import given
from hypothesis import strategies as st

from live_view.picture import SLOTS, ColourSlots


@given(st.lists(st.sets(st.integers(0, 40), max_size=20), max_size=30))
def test_no_two_clusters_share_a_number_and_none_changes_its_own(steps: list[set[int]]) -> None:
    slots, before, most = ColourSlots(), dict[int, int](), 0
    for alive in steps:
        now = slots.assign(sorted(alive))
        assert now.keys() == alive
        assert len(set(now.values())) == len(now)
        assert all(now[cluster] == before[cluster] for cluster in alive & before.keys())
        most = max(most, len(alive))
        assert max(now.values(), default=0) < max(most, SLOTS)
        before = now


def test_a_candidate_does_not_look_like_the_one_that_has_just_ended() -> None:
    slots = ColourSlots()
    was = slots.assign([1, 2])[2]
    slots.assign([1])
    assert slots.assign([1, 3])[3] != was
