"""Hears all beliefs of a system, from its first to its last."""

from collections.abc import Callable
from itertools import count

from clustermcl.stack import Stack
from coordinator.belief.outcome import Outcome
from coordinator.process import filter_settings
from evaluation import in_process
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from tests.integration.waiting import PATIENCE_S
from tests.integration.worlds import world_of
from worker.map_model import sensor_model
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session
from zenoh_link.wire import Events, Received, Token, subscribe, watch

POLL_S, SILENCE_S = 0.05, PATIENCE_S


def beliefs_of(
    stack: Stack,
    settings: Settings,
    *,
    at_step: dict[int, Callable[[], None]] | None = None,
    among_foreign: bool = False,
) -> list[Belief]:
    """Run a system to the end of its source.

    Args:
        stack: not started yet.
        settings: of the system.
        at_step: actions on receipt of a step's belief.
        among_foreign: messages of another kind on the key are left out.
    """
    stack.start_without_coordinator()
    inbox: Events = Inbox({"belief": 4096})
    received: list[Belief] = []
    alive: set[str] = set()
    with open_session(settings.zenoh, settings.robot, StopFlag(), wait_s=PATIENCE_S) as session:
        subscribe(session, keys.BELIEF, Belief, inbox, "belief")
        watch(session, keys.ALL_WORKERS_ALIVE, inbox)
        coordinator_started = False
        silent_s = 0.0
        for _ in count():
            event = inbox.get(POLL_S)
            stack.check()
            silent_s = 0.0 if event is not None else silent_s + POLL_S
            assert silent_s < SILENCE_S, f"nothing heard; last {received[-1:]}"
            match event:
                case Token(key=key, alive=True):
                    alive.add(key)
                case Received(payload=payload):
                    try:
                        received.append(decode(payload, Belief))
                    except MalformedMessageError:
                        assert among_foreign
                        continue
                    (at_step or {}).pop(received[-1].step, lambda: None)()
            if not coordinator_started and len(alive) == settings.worker.count:
                stack.start_coordinator()
                coordinator_started = True
            if received and received[-1].last:
                break
    return received


def outcomes_of(settings: Settings, *, steps: int) -> list[Outcome]:
    """The same run in this process, without Zenoh."""
    world = world_of(settings)
    source = SimulatedSource(Simulation(world, settings.seed), steps=steps)
    scans = (scan for scan, _ in simulated_steps(source, settings.bridge, world.map.digest))
    model = sensor_model(world.map, settings.sensor, cache_folder=None)
    plain = filter_settings(settings)
    return [outcome for _, outcome in in_process.outcomes(scans, model, plain)]
