import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from process_runtime.supervisor import work_without_preempting

if not hasattr(os, "SCHED_BATCH"):
    pytest.skip("only Linux has such a policy", allow_module_level=True)


def policy_after_asking() -> int:
    work_without_preempting()
    return os.sched_getscheduler(0)


def test_it_is_of_the_thread_that_asks_and_of_no_other() -> None:
    before = os.sched_getscheduler(0)
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(policy_after_asking).result() == os.SCHED_BATCH
    assert os.sched_getscheduler(0) == before


def test_where_it_is_forbidden_work_goes_on_as_usual(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> None:
        raise PermissionError("not here")

    monkeypatch.setattr(os, "sched_setscheduler", forbidden)
    before = os.sched_getscheduler(0)
    assert policy_after_asking() == before
