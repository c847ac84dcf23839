from functools import partial
from operator import methodcaller
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.jobs.jobs import running
from clustermcl.protocol.errors import MalformedMessageError, UnreachableError
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.protocol.steps import MapMessage, Scan
from clustermcl.protocol.work import Assignment, OrderAnswer, Report, TakeOver
from clustermcl.worker.job_table import MissingScans
from clustermcl.worker.worker import (
    HISTORY_TIMEOUT_S,
    KEPT_TERMS,
    LOST_SCANS_TIMEOUT_S,
    Answer,
    BuildModel,
    FetchMap,
    FetchScans,
    Instruction,
    TermFence,
    Warn,
    Worker,
)
from tests.unit.coordinator.living import MAP, WorkerEvent
from tests.unit.coordinator.reports import checkpoint, work_order
from tests.unit.worker.test_job_table import SETTINGS, cloud, scan, track
from tests.unit.worker.test_job_table import model as model  # noqa: PLC0414 - a fixture

on_scan = partial(methodcaller, "on_scan")
on_order = partial(methodcaller, "on_order")
on_take_over = partial(methodcaller, "on_take_over")
on_map = partial(methodcaller, "on_map")
on_map_failure = partial(methodcaller, "on_map_failure")
on_model = partial(methodcaller, "on_model")
on_history = partial(methodcaller, "on_history")
on_no_history = partial(methodcaller, "on_no_history")
NO_ANSWER = UnreachableError(
    peer="map", problem="no answer on 'map': nobody is there", waited_s=30.0
)


def handled(worker: Worker, *events: WorkerEvent) -> list[Instruction]:
    return [event(worker) for event in events][-1]


def grid(digest: str = "map") -> MapMessage:
    return replace(MAP, digest=digest)


def asked(
    number: int, *begin: Assignment, term: int = 1, digest: str = "map",
    keep: tuple[tuple[str, int], ...] = (), sensor: dict[str, object] | None = None,
    repeat_after: int | None = None,
) -> WorkerEvent:  # fmt: skip
    """An order; its question has its number."""
    settings = msgspec.to_builtins(SETTINGS) | ({"sensor": sensor} if sensor else {})
    order = work_order(
        number, term=term, map_digest=digest, filter_settings=settings, snapshot_every_steps=0,
        keep=keep, begin=begin, repeat_after=repeat_after,
    )  # fmt: skip
    return on_order(number, order)


def answers(instructions: list[Instruction]) -> dict[int, OrderAnswer]:
    return {
        i.question: i.message
        for i in instructions
        if isinstance(i, Answer) and isinstance(i.message, OrderAnswer)
    }


def reported(instructions: list[Instruction]) -> list[tuple[str, int]]:
    return [(one.job_id, one.step) for one in reports(instructions)]


def causes(instructions: list[Instruction]) -> list[str]:
    return [i.cause for i in instructions if isinstance(i, Warn)]


def jobs(worker: Worker) -> list[str]:
    (answer,) = worker.on_take_over(0, TakeOver(sender="nobody", term=0))
    return [held.job_id for held in answer.message.holds]


@pytest.fixture
def fresh() -> Worker:
    return Worker("w")


@pytest.fixture
def tracking(fresh: Worker, model: SensorModel) -> Worker:
    """Has the map, and a job that begins after step 0."""
    handled(fresh, asked(1, track("c0", cloud())), on_map(grid()), on_model("map", model))
    assert handled(fresh, on_history(MissingScans(1, None), ())) == []
    return fresh


# --- scans


def test_a_scan_of_another_map_is_only_counted(tracking: Worker) -> None:
    refused = asked(2, track("c1", cloud()), digest="new"), on_map(grid("newer"))
    assert causes(handled(tracking, *refused)) == ["order for another map"]
    other = replace(scan(1), map_digest="another")
    expected = Warn("scan of another map", "step 1 is of map another")
    assert handled(tracking, on_scan(other)) == [expected]
    assert reported(handled(tracking, on_scan(scan(1)))) == [("c0", 1)]


def test_a_repeated_scan_repeats_its_reports(tracking: Worker) -> None:
    first = handled(tracking, on_scan(scan(1)))
    assert reported(first) == [("c0", 1)]
    assert handled(tracking, on_scan(scan(1))) == first
    assert handled(tracking, on_scan(scan(2)), on_scan(scan(1))) == [], "it is past"


def test_jobs_wait_for_scans_that_were_lost_and_take_them_in_order(tracking: Worker) -> None:
    lost = MissingScans(2, 4)
    asking = handled(tracking, on_scan(scan(1)), on_scan(scan(5)))
    assert asking == [FetchScans(lost, LOST_SCANS_TIMEOUT_S)]
    assert handled(tracking, on_scan(scan(6))) == []
    caught_up = handled(tracking, on_history(lost, (scan(2), scan(3), scan(4))))
    assert reported(caught_up) == [("c0", step) for step in range(2, 7)]
    assert reported(handled(tracking, on_scan(scan(7)))) == [("c0", 7)]


def test_scans_that_stay_lost_cost_only_their_steps(tracking: Worker) -> None:
    handled(tracking, on_scan(scan(1)), on_scan(scan(3)))
    failed = handled(tracking, on_no_history(MissingScans(2, 2), "no answer"))
    assert failed[0] == Warn("no scan history", "no answer")
    assert reported(failed) == [("c0", 3)]
    assert reported(handled(tracking, on_scan(scan(4)))) == [("c0", 4)]


def test_a_worker_that_falls_behind_skips_scans_and_requests_none(tracking: Worker) -> None:
    handled(tracking, on_scan(scan(1)))
    assert reported(handled(tracking, on_scan(scan(5), dropped=3))) == [("c0", 5)]
    later = handled(tracking, on_scan(scan(8), dropped=3))
    assert later == [FetchScans(MissingScans(6, 7), LOST_SCANS_TIMEOUT_S)], "lost on the way"


# --- settings that are live


def live(step: int, **values: Any) -> Scan:
    return replace(scan(step), settings=LiveSettings(**values))


def reports(instructions: list[Instruction]) -> list[Report]:
    return [one for one in instructions if isinstance(one, Report)]


def test_a_live_motion_model_holds_from_its_scan_on(tracking: Worker, model: SensorModel) -> None:
    handled(tracking, on_scan(scan(1)))
    noisy = {"drive_noise_per_metre": 0.5, "turn_noise_per_metre": 0.7}
    (report,) = reports(handled(tracking, on_scan(live(2, **noisy))))
    motion = replace(SETTINGS.motion, **noisy)
    alone = running(track("c0", cloud()), model, SETTINGS, sender="w")
    alone.advance(scan(1))
    alone.use(model, replace(SETTINGS, motion=motion))
    assert report == alone.advance(scan(2))
    assert report != running(track("c0", cloud()), model, SETTINGS, sender="w").advance(scan(2))


def test_scans_with_another_sensor_model_wait_for_that_model(
    tracking: Worker, model: SensorModel
) -> None:
    wide = replace(SETTINGS.sensor, hit_sigma_m=0.4, max_beams=9)
    values = {"hit_sigma_m": 0.4, "max_beams": 9}
    handled(tracking, on_scan(scan(1)))
    (build,) = handled(tracking, on_scan(live(2, **values)))
    assert build.settings == wide
    assert handled(tracking, on_scan(live(3, **values))) == []
    assert handled(tracking, on_scan(scan(4))) == []  # and back again
    other = computed_model(model.grid, wide)
    *published, again = handled(tracking, on_model("map", other))
    alone = running(track("c0", cloud()), model, SETTINGS, sender="w")
    alone.advance(scan(1))
    alone.use(other, replace(SETTINGS, sensor=wide))
    assert reports(published) == [alone.advance(scan(2)), alone.advance(scan(3))]
    assert again.settings == SETTINGS.sensor
    alone.use(model, SETTINGS)
    assert reports(handled(tracking, on_model("map", model))) == [alone.advance(scan(4))]


def test_a_new_job_uses_the_live_settings(tracking: Worker, model: SensorModel) -> None:
    values = {"max_beams": 9}
    fewer = replace(SETTINGS.sensor, max_beams=9)
    handled(
        tracking, on_scan(live(1, **values)), on_model("map", computed_model(model.grid, fewer))
    )
    answered = handled(tracking, asked(2, track("c1", cloud()), keep=(("c0", 1),)))
    assert not any(isinstance(one, BuildModel) for one in answered)
    assert answers(answered)[2].problem == ""
    assert {one.job_id for one in reports(handled(tracking, on_scan(live(2, **values))))} == {
        "c0",
        "c1",
    }


def test_a_model_that_failed_is_requested_again_with_the_next_scan(
    tracking: Worker, model: SensorModel
) -> None:
    handled(tracking, on_scan(live(1, max_beams=9)))
    assert handled(tracking, on_map_failure(NO_ANSWER)) == []
    (fetch,) = handled(tracking, on_scan(live(2, max_beams=9)))
    assert fetch == FetchMap()
    (build,) = handled(tracking, on_map(grid()))
    built = computed_model(model.grid, build.settings)
    assert reported(handled(tracking, on_model("map", built))) == [("c0", 1), ("c0", 2)]


# --- orders


def test_an_order_is_answered_when_the_map_and_its_model_are_there(
    fresh: Worker, model: SensorModel
) -> None:
    order = asked(1, track("c0", cloud()))
    assert handled(fresh, order) == [FetchMap()]
    assert handled(fresh, on_map(grid())) == [BuildModel(grid(), SETTINGS.sensor)]
    done = handled(fresh, on_model("map", model))
    expected = OrderAnswer(sender="w", order=1, term=1, jobs=(("c0", 1, 0),))
    assert done == [Answer(1, expected), FetchScans(MissingScans(1, None), HISTORY_TIMEOUT_S)]


def test_scans_that_come_while_the_map_is_fetched_are_not_lost(
    fresh: Worker, model: SensorModel
) -> None:
    handled(fresh, on_scan(scan(0)), asked(1, track("c0", cloud())), on_scan(scan(1)))
    handled(fresh, on_map(grid()), on_scan(scan(2)))
    assert reported(handled(fresh, on_model("map", model))) == [("c0", 1), ("c0", 2)]


@pytest.mark.parametrize("job_id", ["c0", "c1"], ids=["the same again", "another"])
def test_an_order_that_comes_while_the_map_is_fetched_supersedes_the_one_that_waits(
    fresh: Worker, model: SensorModel, job_id: str
) -> None:
    assert handled(fresh, asked(1, track("c0", cloud()))) == [FetchMap()]
    again = handled(fresh, asked(2, track(job_id, cloud())))
    before = OrderAnswer(sender="w", order=0, term=1, jobs=())
    assert again == [Answer(1, before)], "and the map is not asked for again"
    done = handled(fresh, on_map(grid()), on_model("map", model))
    assert [(question, a.order) for question, a in answers(done).items()] == [(2, 2)]
    assert jobs(fresh) == [job_id]


def test_an_order_that_needs_no_map_supersedes_one_that_waits_for_it(
    tracking: Worker, model: SensorModel
) -> None:
    other = msgspec.to_builtins(SETTINGS.sensor) | {"max_beams": 59}
    asking = handled(tracking, asked(2, track("c1", cloud()), sensor=other))
    assert [type(do) for do in asking] == [BuildModel]
    done = handled(tracking, asked(3, keep=(("c0", 1),)))
    assert {question: a.order for question, a in answers(done).items()} == {2: 1, 3: 3}
    assert handled(tracking, on_model("map", model)) == []
    assert jobs(tracking) == ["c0"]


@pytest.mark.parametrize(
    ("events", "cause", "problem"),
    [
        pytest.param(
            [on_map_failure(NO_ANSWER)], "order refused", str(NO_ANSWER), id="it never arrives"
        ),
        pytest.param(
            [on_map(grid("another"))], "order for another map", "'w' has map another, expected map",
            id="another",
        ),
        pytest.param(
            [on_map(grid()), on_map_failure(ValueError("the map has no obstacle"))],
            "order refused", "the map has no obstacle", id="no sensor model can be built of it",
        ),
    ],
)  # fmt: skip
def test_an_order_whose_map_cannot_be_used_is_refused_and_the_next_one_fetches_it_again(
    fresh: Worker, events: list[WorkerEvent], cause: str, problem: str
) -> None:
    refused = handled(fresh, asked(1, track("c0", cloud())), *events)
    assert causes(refused) == [cause]
    assert answers(refused)[1].problem == problem
    assert handled(fresh, asked(2, track("c0", cloud()))) == [FetchMap()]


def test_an_order_for_another_map_fetches_that_and_its_model(
    tracking: Worker, model: SensorModel
) -> None:
    handled(tracking, asked(2, track("c1", cloud()), digest="new"))
    assert handled(tracking, on_map(grid("new"))) == [BuildModel(grid("new"), SETTINGS.sensor)]
    handled(tracking, on_model("new", model))
    assert jobs(tracking) == ["c1"]
    assert causes(handled(tracking, on_scan(scan(1)))) == ["scan of another map"]


def test_an_order_of_an_old_term_is_refused_with_the_new_term(tracking: Worker) -> None:
    handled(tracking, asked(1, keep=(("c0", 1),), term=5))
    refused = handled(tracking, asked(9, term=4))
    assert causes(refused) == ["order of an old term"]
    assert (answers(refused)[9].term, jobs(tracking)) == (5, ["c0"])


def test_an_order_whose_coordinator_is_taken_over_from_while_it_waits_is_refused(
    fresh: Worker, model: SensorModel
) -> None:
    handled(fresh, asked(1, track("c0", cloud())), on_take_over(9, TakeOver(sender="next", term=2)))
    refused = handled(fresh, on_map(grid()), on_model("map", model))
    assert causes(refused) == ["order of an old term"]
    assert jobs(fresh) == []


def test_an_overtaken_order_is_ignored(tracking: Worker) -> None:
    handled(tracking, asked(3, keep=(("c0", 1),)))
    left_out = handled(tracking, asked(2))
    assert causes(left_out) == ["order overtaken"]
    assert (answers(left_out)[2].order, jobs(tracking)) == (3, ["c0"])


def test_an_order_repeats_the_reports_that_may_be_lost(tracking: Worker) -> None:
    for step in (1, 2, 3):
        handled(tracking, on_scan(scan(step)))
    assert reported(handled(tracking, asked(2, keep=(("c0", 1),)))) == []
    again = handled(tracking, asked(3, keep=(("c0", 1),), repeat_after=1))
    assert reported(again[1:]) == [("c0", 2), ("c0", 3)]


def test_an_order_that_cannot_be_read_or_has_invalid_settings_supersedes_no_order(
    tracking: Worker,
) -> None:
    error = MalformedMessageError(expected="WorkOrder", problem="no", kind="field")
    refused = tracking.refuse(3, error)
    assert causes(refused) == ["malformed WorkOrder: field"]
    assert answers(refused)[3].problem == str(error)
    refused = handled(tracking, asked(900, sensor={"no_such": 1}))
    assert causes(refused) == ["order refused"]
    assert "no_such" in answers(refused)[900].problem
    assert answers(handled(tracking, asked(2)))[2].order == 2


# --- a job that begins behind


def test_a_job_that_begins_behind_waits_for_history_while_others_continue(tracking: Worker) -> None:
    for step in range(1, 71):  # more than are kept at hand
        on_scan(scan(step))(tracking)
    begun = handled(tracking, asked(2, track("c1", cloud(step=3)), keep=(("c0", 1),)))
    missing = MissingScans(4, 6)
    assert begun[1:] == [FetchScans(missing, HISTORY_TIMEOUT_S)]
    assert reported(handled(tracking, on_scan(scan(71)))) == [("c0", 71)]
    caught_up = handled(tracking, on_history(missing, tuple(map(scan, (4, 5, 6)))))
    assert reported(caught_up) == [("c1", step) for step in range(4, 72)]


def test_a_worker_needs_scans_only_for_a_job_and_fetches_those_since_it_began(
    tracking: Worker,
) -> None:
    handled(tracking, on_scan(scan(1)))
    assert tracking.needs_scans
    handled(tracking, asked(2))
    assert not tracking.needs_scans
    assert handled(tracking, on_scan(scan(2))) == []
    again = handled(tracking, asked(3, track("c1", cloud(step=90), epoch=2)))
    assert tracking.needs_scans
    assert again[1:] == [FetchScans(MissingScans(91, None), HISTORY_TIMEOUT_S)]


def test_repeated_orders_request_past_scans_once_and_a_wider_request_replaces_it(
    fresh: Worker, model: SensorModel
) -> None:
    """A worker with the scan 5 and a job that begins after step 2."""
    handled(fresh, asked(1, track("c0", cloud(step=2))), on_scan(scan(5)), on_map(grid()))
    begun = handled(fresh, on_model("map", model))
    assert begun[1:] == [FetchScans(MissingScans(3, 4), HISTORY_TIMEOUT_S)]
    again = handled(fresh, asked(2, track("c0", cloud(step=2))))
    assert [type(do) for do in again] == [Answer]
    wider = handled(fresh, on_scan(scan(8)))
    assert wider == [FetchScans(MissingScans(3, 7), LOST_SCANS_TIMEOUT_S)]
    assert handled(fresh, on_history(MissingScans(3, 4), (scan(3), scan(4)))) == []
    caught_up = handled(fresh, on_history(MissingScans(3, 7), tuple(map(scan, range(3, 8)))))
    assert reported(caught_up) == [("c0", step) for step in range(3, 9)]


# --- a coordinator takes over


def test_a_new_coordinator_gets_jobs_and_terms(tracking: Worker) -> None:
    assert tracking.on_checkpoint(checkpoint(1)) == []
    (answer,) = handled(tracking, on_take_over(9, TakeOver(sender="next", term=2)))
    state = answer.message
    assert state.term == 2
    assert (state.terms, state.founded) == ((1, 2), 1)
    assert [held.job_id for held in state.holds] == ["c0"]


def test_all_received_terms_are_known_and_the_last_one_with_a_belief() -> None:
    term_fence = TermFence()
    term_fence.on_checkpoint(checkpoint(5, 1))
    term_fence.on_checkpoint(checkpoint(5, 2))
    term_fence.on_term(9)
    assert term_fence.check(work_order(term=10)), "orders of a new coordinator count from the start"
    term_fence.on_checkpoint(checkpoint(6, 1))
    term_fence.on_checkpoint(checkpoint(10, 1, founded=False))
    assert (term_fence.term, term_fence.terms, term_fence.founded) == (10, (5, 9, 10, 6), 6)
    for term in range(11, 100):
        term_fence.on_term(term)
    assert term_fence.terms == tuple(range(100 - KEPT_TERMS, 100))
