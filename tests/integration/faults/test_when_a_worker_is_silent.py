"""docs/failures.md: workers that answer orders and never report delay a search for seconds
only."""

import uuid

from msgspec.structs import replace

from process_runtime.settings import CoordinatorSettings
from protocol import keys
from protocol.answers import CommandDone, Relocalize
from tests.integration.faults.system import IMPATIENT, System, system
from tests.integration.faults.untrue_worker import untrue_workers
from tests.integration.waiting import PATIENCE_S, wait_until
from zenoh_link.wire import ask

SEARCHES = 2
COORDINATOR = CoordinatorSettings(step_deadline_s=1.0, stale_after_s=5.0)
FEW_SHARDS = replace(IMPATIENT, coordinator=COORDINATOR)
MANY_SHARDS = replace(FEW_SHARDS, search=replace(FEW_SHARDS.search, shards=8))
"""Eight shards, so that each of five workers gets at least one."""
NAMES = [f"aa-liar-{n}" for n in range(60)]
"""Before the honest ones by name."""
ASKED = 30


def relocalize(tested: System) -> None:
    command = Relocalize(sender="test", command_id=uuid.uuid4().hex)
    done = ask(tested.session, keys.RELOCALIZE, CommandDone, timeout_s=PATIENCE_S, message=command)
    assert done.problem == ""


def is_found_again(tested: System) -> None:
    """Search everywhere; until places are tracked."""
    step = tested.step
    relocalize(tested)
    wait_until(lambda: tested.step > step + 5 and tested.tracks())


def test_a_worker_that_never_reports_stops_no_search() -> None:
    """It is one of a machine whose other workers report, so it is given a shard."""
    with system(MANY_SHARDS) as tested:
        tested.wait_until_it_tracks()
        with untrue_workers(tested, "worker-00") as (silent,):
            wait_until(lambda: silent.had)  # it is not given up before some steps
            for _ in range(SEARCHES):
                is_found_again(tested)
            assert any(job_id.startswith("s") for job_id in silent.had)


def test_sixty_names_that_never_report_stop_no_search_and_seldom_cause_dead_reckoning() -> None:
    with system(FEW_SHARDS) as tested, tested.client as client:
        tested.wait_until_it_tracks()
        with untrue_workers(tested, *NAMES):
            wait_until(lambda: client.pose().workers >= len(NAMES))
            is_found_again(tested)
            told = []
            for _ in range(ASKED):
                tested.wait_for_steps(1)
                told.append(client.pose().freshness)
            assert told.count("fresh") > 0.9 * ASKED
            assert max(len(belief.missing) for belief in tested.beliefs[-ASKED:]) <= 1
