"""A coordinator's snapshot holds all that it knows, and reading one runs nothing."""

import ast
import pickle
from collections import deque
from pathlib import Path
from typing import Any

import hypothesis
import msgspec
import pytest
from hypothesis import strategies as st

from coordinator.coordinator import Coordinator
from coordinator.events import Event, ScanArrived, TimePassed, WorkerJoined, WorkerLeft
from coordinator.instructions import Instruction
from coordinator.recorder.records import Started, without_bulk
from coordinator.recorder.snapshot import ATTRIBUTES, freeze, thaw
from particle_filter.sensor_model import SensorModel
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import head
from tests.unit.coordinator.recorder.test_replay import ACTIONS, live
from tests.unit.coordinator.reports import scan

ROOT = Path(__file__).parents[4]
PACKAGES = [path.parent for path in ROOT.glob("*/__init__.py") if path.parent.name != "tests"]
STARTED = head().started


class Trap:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self.path,)


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return symmetric_room()


def test_a_fresh_coordinator_is_restored() -> None:
    coordinator = STARTED.coordinator()
    coordinator.handle(WorkerJoined("w0"), 1)
    coordinator.handle(WorkerLeft("w0"), 2)
    restored = thaw(STARTED, freeze(coordinator))
    assert (
        restored.handle(ScanArrived(scan(0)), 3)
        == coordinator.handle(ScanArrived(scan(0)), 3)
        != []
    )


def contents(value: Any) -> Any:  # noqa: PLR0911 - one for each type
    """All that an object holds, and what its parts hold, in a form that can be compared."""
    match without_bulk(value):
        case dict() as items:
            return type(value).__name__, [(key, contents(item)) for key, item in items.items()]
        case list() | tuple() as items:
            return [contents(item) for item in items]
        case set() as items:
            return sorted(map(repr, items))
        case deque(maxlen=most) as items:
            return most, [contents(item) for item in items]
        case msgspec.Struct() as struct:
            return repr(msgspec.to_builtins(struct, order="deterministic"))
        case part if type(part).__module__.startswith(
            ("coordinator.", "particle_filter.trajectory", "protocol.")
        ):
            return {n: contents(item) for n, item in vars(part).items() if not callable(item)}
        case other:
            return repr(other)


class Thawed:
    """Behaves as a coordinator; now and then its snapshot has to hold all that it knows."""

    def __init__(self, started: Started) -> None:
        self._coordinator, self._started = started.coordinator(), without_bulk(started)
        self._events = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._coordinator, name)

    def handle(self, event: Event, now_ns: int) -> list[Instruction]:
        instructions = self._coordinator.handle(event, now_ns)
        self._events += 1
        if self._events % 7 == 0:
            thawed = thaw(self._started, freeze(self._coordinator))
            assert contents(thawed) == contents(self._coordinator)
        return instructions


@hypothesis.settings(deadline=None, max_examples=8)
@hypothesis.given(st.lists(ACTIONS, min_size=5, max_size=30))
def test_a_snapshot_holds_every_attribute_of_every_part(
    model: SensorModel, actions: list[tuple[str, int]]
) -> None:
    def made(started: Started) -> Coordinator:
        return Thawed(started)  # type: ignore[return-value] # it behaves as one

    live(Living(model, made=made), [*[("drive", 0)] * 8, *actions])


FOLLOWS_FROM_SETTINGS = {
    *(
        "_sender",
        "_publication",
        "_version",
        "_seed",
        "settings",
        "_settings",
        "_rules",
        "_sensor",
        "_motion",
    ),
    *(
        "_bridge",
        "_snapshot_every_steps",
        "_stale_after_s",
        "_stale_ns",
        "_dead_reckoning_after_gates",
    ),
    *("_is_folder_named", "_keeps_pose_on_new_map", "_last_place", "_last_pose_probability"),
    *("_own_us", "_started_ns", "_began_ns", "_filter_settings", "_most", "_every_ns", "_held_ns"),
    *("_mirrored", "_kind"),
    *("_live", "sensor", "bridge"),  # set by `_state.live`
}
"""Attributes that nothing changes after the coordinator was made, or that `live` settles."""


def test_an_attribute_is_in_the_snapshot_or_follows_from_the_settings() -> None:
    """A new one has to be put where it belongs, also one that runs seldom change."""
    coordinator = Coordinator(
        "c", FilterSettings(), CoordinatorSettings(), "v", 0, usual_delay_ns=1
    )
    coordinator.handle(TimePassed(), 0)
    coordinator.handle(ScanArrived(msgspec.structs.replace(scan(0), live=True)), 1)
    forgotten, parts = set[str](), {id(coordinator): (coordinator, "")}
    waiting: list[tuple[object, str]] = [(coordinator, "")]
    while waiting:
        part, path = waiting.pop()
        for name, value in vars(part).items():
            if hasattr(value, "__dict__") and name not in ATTRIBUTES.get(path, ()):
                if id(value) not in parts:
                    parts[id(value)] = value, f"{path}.{name}".strip(".")
                    waiting.append(parts[id(value)])
            elif name not in FOLLOWS_FROM_SETTINGS and name not in ATTRIBUTES.get(path, ()):
                forgotten.add(f"{path}.{name}")
    assert forgotten == set()
    assert set(ATTRIBUTES) <= {path for _, path in parts.values()}


@pytest.mark.parametrize("data", [b"", b"nonsense", pickle.dumps(7), b"\x91" * 100_000])
def test_what_is_no_snapshot_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not a coordinator's snapshot"):
        thaw(STARTED, data)


def test_a_pickle_in_a_snapshot_is_not_run(tmp_path: Path) -> None:
    trap = pickle.dumps(Trap(tmp_path / "trap"))
    parts = msgspec.msgpack.decode(freeze(STARTED.coordinator()))
    for data in (trap, msgspec.msgpack.encode([trap, *parts[1:]])):
        with pytest.raises(ValueError, match="not a coordinator's snapshot"):
            thaw(STARTED, data)
    assert list(tmp_path.iterdir()) == []


def test_no_module_of_the_product_reads_pickles() -> None:
    """Only numba's cache of compiled kernels, which numba reads, is of pickles."""
    reading = {
        f"{file.relative_to(ROOT)}: {found}"
        for package in PACKAGES
        for file in package.rglob("*.py")
        for found in loaders_of_objects(ast.parse(file.read_text()))
    }
    assert reading == {"particle_filter/kernels.py: pickle"}
    kernels = (ROOT / "particle_filter" / "kernels.py").read_text()
    assert [line for line in kernels.splitlines() if "pickle" in line.lower()] == [
        "import pickle",
        "_CACHE_ERRORS = (OSError, EOFError, pickle.UnpicklingError)",
    ]


PICKLES = {"pickle", "_pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib", "jsonpickle"}


def loaders_of_objects(module: ast.Module) -> set[str]:
    """Imports and calls of a module that would create any object named in a file."""
    found = set[str]()
    for node in ast.walk(module):
        match node:
            case ast.Import(names):
                found |= {name.name.partition(".")[0] for name in names} & PICKLES
            case ast.ImportFrom(module=str(source)):
                found |= {source.partition(".")[0]} & PICKLES
            case ast.keyword(arg="allow_pickle", value=value):
                if not (isinstance(value, ast.Constant) and value.value is False):
                    found.add("allow_pickle")
            case ast.Call(ast.Name("eval" | "exec" | "__import__" as name)):
                found.add(name)
            case ast.Attribute(attr="unsafe_load" | "UnsafeLoader" | "FullLoader" as name):
                found.add(name)
    return found


def test_loaders_of_objects_are_found() -> None:
    """The test above can fail."""
    text = "import pickle as p\nfrom marshal import loads\nnp.load(f, allow_pickle=True)\neval(f)"
    assert loaders_of_objects(ast.parse(text)) == {"pickle", "marshal", "allow_pickle", "eval"}
    assert loaders_of_objects(ast.parse("np.load(f, allow_pickle=False)")) == set()
