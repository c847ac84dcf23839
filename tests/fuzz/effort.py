"""How many cases: a few thousand in all by default, as many as one likes in a long run.

CLUSTERMCL_FUZZ_CASES=100000 pytest tests/fuzz -o timeout=7200
"""

import os

from hypothesis import HealthCheck, settings

ALL_CASES = int(os.environ.get("CLUSTERMCL_FUZZ_CASES", "3000"))


def cases(share: float) -> settings:
    """Settings of a fuzz test that gets this share of all cases.

    No deadline for one case: on a shared machine the slowest would be a false alarm. A hang ends
    with the time limit of the test. Nothing is written to the working folder.
    """
    return settings(
        max_examples=max(20, round(ALL_CASES * share)),
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
