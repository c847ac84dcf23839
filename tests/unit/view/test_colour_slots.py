from hypothesis import given
from hypothesis import strategies as st

from clustermcl.view.picture import SLOTS, ColourSlots


@given(st.lists(st.sets(st.integers(0, 40), max_size=20), max_size=30))
def test_each_cluster_has_a_slot_of_its_own_that_never_changes(steps: list[set[int]]) -> None:
    slots, before, most = ColourSlots(), dict[int, int](), 0
    for alive in steps:
        now = slots.assign(sorted(alive))
        assert now.keys() == alive
        assert len(set(now.values())) == len(now)
        assert all(now[cluster] == before[cluster] for cluster in alive & before.keys())
        most = max(most, len(alive))
        assert max(now.values(), default=0) < max(most, SLOTS)
        before = now


def test_a_new_cluster_gets_another_slot_than_the_last_ended_one() -> None:
    slots = ColourSlots()
    was = slots.assign([1, 2])[2]
    slots.assign([1])
    assert slots.assign([1, 3])[3] != was
