import math
import multiprocessing
import time
from collections.abc import Callable
from typing import Any

import pytest
from msgspec.structs import replace

from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.settings import BeliefSettings, FilterSettings
from clustermcl.jobs.advising import advice
from clustermcl.link.node import Node
from clustermcl.protocol.advice import Advice, AdviceQuestion
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.stop import StopFlag
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.worker.adviser import Adviser
from clustermcl.worker.worker import Advise, Instruction, Worker
from tests.unit.evaluation.places import place

SETTINGS = FilterSettings()
CROSS = world("cross_feature")
MODEL = computed_model(CROSS.map.grid, SETTINGS.sensor)
EQUAL_ARMS = computed_model(world("cross").map.grid, SETTINGS.sensor)
FLAT = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.001)


def first_scan() -> Scan:
    maker = StepMaker(BridgeSettings(), CROSS.map.digest, "test")
    made = (maker.on_reading(r) for tick in Simulation(CROSS, 1) for r in tick.readings)
    return next(step for step in made if step is not None)


SCAN = first_scan()


def question(*poses: tuple[float, float, float], **changed: Any) -> AdviceQuestion:
    places = tuple(
        replace(place(1.0 / len(poses), pose, cluster=number), covariance=FLAT)
        for number, pose in enumerate(poses)
    )
    asked = AdviceQuestion(
        sender="test", step=SCAN.step, map_digest=SCAN.map_digest, hypotheses=places,
        elsewhere_probability=0.0, radius_m=0.25, gate_distance_m=0.2, gate_turn_rad=0.2,
    )  # fmt: skip
    return replace(asked, **changed)


def answer_to(asked: AdviceQuestion) -> Advice:
    return advice(asked, SCAN, MODEL, SETTINGS, "worker-0")


def test_places_of_a_cross_with_one_cabinet_get_ways() -> None:
    asked = question((0.0, 3.7, -1.57), (3.7, 0.0, 3.14))
    reported = answer_to(asked)
    assert reported.ways
    assert reported.clusters == (0, 1)
    assert (reported.step, reported.stamp_ns) == (SCAN.step, SCAN.stamp_ns)


def test_equal_arms_of_a_cross_cannot_be_distinguished() -> None:
    arms = question((0.0, 5.0, 1.57), (5.0, 0.0, 0.0), (0.0, -5.0, -1.57), (-5.0, 0.0, 3.14))
    assert "cannot be distinguished" in advice(arms, SCAN, EQUAL_ARMS, SETTINGS, "worker-0").note


def test_without_a_second_place_a_note_has_the_reason() -> None:
    assert "only one place" in answer_to(question((0.0, 3.7, -1.57))).note
    assert "no place" in answer_to(question()).note


def test_from_a_probable_elsewhere_a_note_says_so() -> None:
    asked = question((0.0, 3.7, -1.57), (3.7, 0.0, 3.14), elsewhere_probability=0.8)
    assert "probably at another place" in answer_to(asked).note
    later = replace(SETTINGS, belief=BeliefSettings(lost_probability=0.9))
    assert advice(asked, SCAN, MODEL, later, "worker-0").note == ""


def test_places_in_walls_have_no_common_way() -> None:
    asked = question((5.0, 5.0, 0.0), (-5.0, -5.0, math.pi))
    reported = advice(asked, SCAN, EQUAL_ARMS, SETTINGS, "worker-0")
    assert reported.ways == ()
    assert reported.note == "no ground is free at all 2 places"


def note_of(instructions: list[Instruction]) -> str:
    (answer,) = instructions
    return answer.message.note


def test_a_question_is_computed_with_the_model_and_the_scan_of_its_step() -> None:
    worker = Worker("worker-0")
    asked = question((0.0, 3.7, -1.57), (3.7, 0.0, 3.14))
    assert "no map" in note_of(worker.on_advice_query("no map", asked))
    worker._model, worker._ordered, worker._model_digest = MODEL, SETTINGS, CROSS.map.digest
    assert "no scan of step 0" in note_of(worker.on_advice_query("early", asked))
    worker._table.on_scan(SCAN)
    assert "bytes of views" in note_of(worker.on_advice_query("odd", replace(asked, views=b"1")))
    assert worker.on_advice_query("good", asked) == [Advise("good", asked, SCAN, MODEL, SETTINGS)]


class Query:
    def __init__(self) -> None:
        self.answers: list[Advice | str] = []

    def answer(self, advice: Advice) -> None:
        self.answers.append(advice)

    refuse = answer


def turn_until(done: Callable[[], bool], node: Node) -> None:
    deadline_s = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < deadline_s
        node.turn(0.1)


@pytest.fixture
def node() -> Node:
    return Node("worker-0", "worker", Settings(), StopFlag(), peers=None)


def task(asked: AdviceQuestion, query: Query) -> Advise:
    return Advise(query, asked, SCAN, MODEL, SETTINGS)


def test_a_child_answers_one_question_and_of_those_that_wait_only_the_newest(node: Node) -> None:
    """The first child is killed, which costs one answer."""
    adviser, queries = Adviser(node), [Query() for _ in range(3)]
    asked = question((0.0, 3.7, -1.57), (3.7, 0.0, 3.14))
    takes_long = question(*[(0.0, 3.7, -1.57)] * 60)
    for query, one in zip(queries, (takes_long, asked, asked), strict=True):
        adviser.advise(task(one, query))
    (child,) = multiprocessing.active_children()
    child.kill()
    turn_until(lambda: all(query.answers for query in queries), node)
    assert all("ask again" in str(query.answers) for query in queries[:2]), "refusals, no advice"
    assert queries[2].answers == [answer_to(asked)]
    assert multiprocessing.active_children() == []


def test_an_invalid_advice_of_the_child_is_refused(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    invalid = Advice(sender="x" * 1000)
    monkeypatch.setattr("clustermcl.jobs.advising.advice", lambda *_: invalid)
    query, asked = Query(), question((0.0, 3.7, -1.57))
    Adviser(node).advise(task(asked, query))
    turn_until(lambda: bool(query.answers), node)
    assert "ask again" in str(query.answers)
