import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from clustermcl.runtime.supervisor import work_without_preempting

if not hasattr(os, "SCHED_BATCH"):
    pytest.skip("only Linux has such a policy", allow_module_level=True)


def policy_after_asking() -> int:
    work_without_preempting()
    return os.sched_getscheduler(0)


def test_batch_scheduling_applies_to_the_calling_thread_and_may_be_forbidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError("not here")

    before = os.sched_getscheduler(0)
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(policy_after_asking).result() == os.SCHED_BATCH
    assert os.sched_getscheduler(0) == before
    monkeypatch.setattr(os, "sched_setscheduler", forbidden)
    assert policy_after_asking() == before
