import pytest

from benchmarks.same_views import CASES, run
from evaluation.pose_error import CONFIDENT_PROBABILITY
from process_runtime.settings_file import load_settings


@pytest.mark.parametrize("name", ["turn", "pace"])
def test_one_unmapped_block_counts_once_as_evidence(name: str) -> None:
    """Counted at each turn, it made the robot sure of the wrong end of a symmetric hall."""
    case = CASES[name]
    answers = run(case, 0, load_settings(None, case.settings))
    assert not any(a.best >= CONFIDENT_PROBABILITY and not a.is_right for a in answers)
    assert all(a.truth > 0.1 for a in answers)


def test_a_moved_cabinet_makes_no_cluster_overconfident() -> None:
    """Counted in full at each turn, it drew the cloud half a metre off, at five to ten sigma."""
    case = CASES["corridor"]
    answers = run(case, 0, load_settings(None, case.settings))
    assert sum(answer.sds > 5.0 for answer in answers) <= 0.01 * len(answers)
