"""The library: the beliefs of `evaluate`, from plain numpy arrays."""

import gzip
import subprocess
import sys
import warnings
from contextlib import suppress
from itertools import islice
from pathlib import Path

import msgspec
import numpy as np
import pytest

import clustermcl
from clustermcl import (
    Belief,
    ClusterMCL,
    CommandRefusedError,
    Reading,
    SettingsError,
    StateFileError,
    load_map,
    read_recording,
)
from clustermcl.recordings.recording import open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.alone import outcomes_of, outcomes_of_scans
from tests.integration.system.conftest import SMALL
from tests.maps import write_map
from tests.unit.recordings import bags, logs

STEPS = 30


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path_factory.getbasetemp() / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))


@pytest.fixture(scope="module")
def readings() -> list[Reading]:
    """Odometry and scans of a robot in the cross, as it publishes them."""
    made = []
    for tick in islice(Simulation(world("cross_feature"), 3), 150):
        made += [Reading.of(message) for message in (*tick.odometry, tick.laser)]
    return made


def believed(mcl: ClusterMCL, readings: list[Reading]) -> list[Belief]:
    return [belief for reading in readings if (belief := mcl.update(reading)) is not None]


def test_beliefs_equal_those_of_evaluate_bit_for_bit(readings: list[Reading]) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    beliefs, expected = believed(mcl, readings)[:STEPS], outcomes_of(SMALL, steps=STEPS)
    assert len(beliefs) == STEPS
    for belief, outcome in zip(beliefs, expected, strict=True):
        assert belief.hypotheses == outcome.hypotheses, f"step {belief.step}"
        assert belief.state == outcome.state
        assert belief.pose == outcome.hypotheses[0].pose


def test_a_recording_is_read_as_evaluate_reads_it(tmp_path: Path) -> None:
    hall, log = world("hall"), tmp_path / "robot.log"
    map_file = write_map(hall.map, tmp_path, "map")
    lines = []
    for tick in islice(Simulation(hall, 0), 120):
        ranges = np.nan_to_num(tick.laser.ranges.array(), posinf=81.8)
        pose = tick.odometry[0].odom_from_robot
        lines.append(logs.flaser(f"{tick.laser.stamp_ns / 1e9:.3f}", pose, ranges.tolist()))
    log.write_text("\n".join(lines) + "\n")
    grid_map = load_map(map_file)
    bridge = BridgeSettings()
    steps = steps_of(open_recording(log, bridge), bridge, grid_map.digest)
    expected = [outcome.hypotheses for outcome in outcomes_of_scans(steps, grid_map, SMALL)]
    mcl = ClusterMCL(grid_map, settings=SMALL)
    beliefs = [*believed(mcl, list(read_recording(log))), *mcl.finish()]
    assert len(expected) > 5
    assert [belief.hypotheses for belief in beliefs] == expected


def files(folder: Path) -> dict[str, Path]:
    """A recording of each kind that `evaluate` reads."""
    made = {
        "carmen": [logs.odom(1.0), logs.flaser(1.1, (0.5, 0, 0)), logs.odom(1.2)],
        "robot laser": [logs.robot_laser(1.0, (1.0, 2.0, 3.0), (0.1, 0, 0), (0, 0, 0))],
    }
    paths = {}
    for name, lines in made.items():
        paths[name] = folder / f"{name}.log"
        paths[name].write_text("\n".join(lines) + "\n")
    paths["packed"] = folder / "packed.log.gz"
    paths["packed"].write_bytes(gzip.compress(paths["carmen"].read_bytes()))
    mount = bags.fixed_tf("base_link", "laser", (0.2, 0.0, 0.1))
    for form in ("sqlite3", "mcap", "ros1"):
        moves = [bags.tf(at, "odom", "base_link", (1.0, 2.0, 0.0)) for at in (10, 20)]
        sent = [mount, moves[0], bags.scan(10), moves[1]]
        paths[form] = bags.written(folder, form, sent)
    return paths


def test_every_format_is_read_whole(tmp_path: Path) -> None:
    """No field of a reading is lost on the way through the library's class."""
    for name, path in files(tmp_path).items():
        expected = open_recording(path, BridgeSettings()).readings
        assert expected, name
        read = [reading.as_message(0, (9.0, 9.0, 9.0)) for reading in read_recording(path)]
        assert read == [msgspec.structs.replace(one, sender="library") for one in expected], name


def test_readings_of_arrays_give_beliefs_and_a_standing_robot_gives_none() -> None:
    hall = world("hall")
    mcl = ClusterMCL(hall.map, robot_from_laser=(0.1, 0.0, 0.0), seed=1, settings={
        "cluster.particles": 300, "search.poses": 4_000,
    })  # fmt: skip
    tick = next(iter(Simulation(hall, 0)))
    laser = tick.laser
    for odometry, steps in (((0.0, 0.0, 0.0), 1), (np.zeros(3), 1), ([0.3, 0.0, 0.0], 2)):
        mcl.update(
            Reading(
                odometry,
                laser.ranges.array(),
                angle_min=laser.angle_min_rad,
                angle_step=laser.angle_step_rad,
                range_max=laser.range_max_m,
            )
        )
        assert mcl.belief is not None
        assert mcl.belief.step == steps - 1
    assert mcl.update(Reading(np.array([0.3, 0.0, 0.0]), laser.ranges.array(), angle_min=laser.angle_min_rad, angle_step=laser.angle_step_rad, range_max=laser.range_max_m), force=True)  # fmt: skip # noqa: E501
    assert mcl.belief.scan.robot_from_laser == (0.1, 0.0, 0.0)


def test_an_invalid_reading_is_refused_or_counted() -> None:
    with pytest.raises(ValueError, match="a scan, odometry, or both"):
        Reading()
    with pytest.raises(ValueError, match=r"expected \(B,\)"):
        Reading((0, 0, 0), np.ones((2, 2)))
    with pytest.raises(ValueError, match="x, y, heading"):
        Reading((0, 0))
    mcl = ClusterMCL(world("hall").map, settings=SMALL)
    assert mcl.update(Reading((np.nan, 0.0, 0.0))) is None
    assert sum(mcl.dropped.values()) == 1


def test_settings_are_set_by_name_and_invalid_ones_refused() -> None:
    hall = world("hall").map
    for wrong in ("belief.max_cluster", "nonsense", "motion.alpha1", "belief"):
        with pytest.raises(SettingsError, match=wrong):
            ClusterMCL(hall, settings={wrong: 8})
    with pytest.raises(SettingsError, match="expected"):
        ClusterMCL(hall, settings={"belief.max_clusters": 0})


def test_set_pose_and_relocalize_change_the_belief(readings: list[Reading]) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    mcl.set_pose((0.0, 0.0, 0.0))  # before the first scan: remembered
    first = believed(mcl, readings[:20])[0]
    assert first.pose is not None
    assert np.hypot(*first.pose[:2]) < 2.0
    assert first.probability > 0.5
    mcl.relocalize()
    assert mcl.belief is not None
    assert (mcl.belief.state, mcl.belief.hypotheses) == ("searching", ())
    with pytest.raises(CommandRefusedError, match="unknown region 'attic'"):
        mcl.relocalize(region="attic")
    with pytest.raises(CommandRefusedError, match="map"):
        mcl.set_pose((700.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="is invalid"):
        mcl.set_pose((np.inf, 0.0, 0.0))


@pytest.mark.parametrize("after", [1, 4, 17])
def test_a_loaded_state_continues_with_the_same_beliefs_bit_for_bit(
    after: int, readings: list[Reading], tmp_path: Path
) -> None:
    """Also while a search runs: after 1 and 4 steps."""
    settings = msgspec.structs.replace(
        SMALL, search=msgspec.structs.replace(SMALL.search, converged_mass=1.0, max_steps=8)
    )
    first = ClusterMCL(world("cross_feature").map, settings=settings)
    left = iter(readings)
    made = 0
    while made < after:
        made += first.update(next(left)) is not None
    first.set_pose((2.0, 0.0, 0.0)) if after == 17 else None
    first.save(tmp_path / "robot.state")
    assert first.belief is not None
    assert first.belief.searching == (after < 8)
    second = ClusterMCL(world("cross_feature").map, settings=settings)
    second.load(tmp_path / "robot.state")
    assert second.belief is not None
    assert second.belief.hypotheses == first.belief.hypotheses
    assert second.belief.state == first.belief.state
    rest = list(left)
    expected, beliefs = believed(first, rest), believed(second, rest)
    assert len(expected) > 10
    for belief, right in zip(beliefs, expected, strict=True):
        assert (belief.step, belief.hypotheses) == (right.step, right.hypotheses)


@pytest.fixture(scope="module")
def saved(readings: list[Reading], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    believed(mcl, readings[:60])
    file = tmp_path_factory.mktemp("state") / "robot.state"
    mcl.save(file)
    return file.read_bytes()


def test_an_incompatible_state_is_refused_and_changes_nothing(saved: bytes, tmp_path: Path) -> None:
    file = tmp_path / "robot.state"
    mcl = ClusterMCL(world("hall").map, settings=SMALL)
    with pytest.raises(ValueError, match="before the first step"):
        mcl.save(file)
    with pytest.raises(StateFileError, match="no such file"):
        mcl.load(file)
    file.write_bytes(saved)
    with pytest.raises(StateFileError, match="of map "):
        mcl.load(file)
    others = msgspec.structs.replace(SMALL, seed=77)
    with pytest.raises(StateFileError, match="other settings: seed"):
        ClusterMCL(world("cross_feature").map, settings=others).load(file)
    assert mcl.belief is None


def test_a_damaged_state_is_refused_in_a_sentence(saved: bytes, tmp_path: Path) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    file, rng = tmp_path / "robot.state", np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        data = bytearray(saved)
        data[int(rng.integers(len(data)))] = int(rng.integers(256))
        file.write_bytes(data if rng.random() < 0.7 else data[: rng.integers(len(data))])
        with suppress(StateFileError):
            refused += 1
            mcl.load(file)
            refused -= 1
    assert refused > 50
    file.write_bytes(saved)
    mcl.load(file)


def test_after_a_map_change_the_search_starts_with_the_next_scan(readings: list[Reading]) -> None:
    cross, plain = world("cross_feature").map, world("cross").map
    mcl = ClusterMCL(cross, settings=SMALL)
    before = believed(mcl, readings[:150])[-1]
    mcl.change_map(plain)
    assert (mcl.map.digest, mcl.belief) == (plain.digest, None)
    after = believed(mcl, readings[150:])
    assert after[0].step == before.step + 1
    assert after[0].scan.map_digest == plain.digest
    assert {place.age_steps for place in after[0].hypotheses} == {0}
    assert after[-1].map is mcl.map
    assert after[-1].hypotheses


def test_two_lasers_join_a_step_and_one_may_be_upside_down() -> None:
    hall = world("hall")
    places = []
    for upside_down in (False, True):
        mcl = ClusterMCL(hall.map, settings=SMALL)
        for tick in islice(Simulation(hall, 0), 12):
            laser = tick.laser
            ranges = laser.ranges.array()
            scan = {
                "ranges": ranges[::-1] if upside_down else ranges,
                "angle_min": laser.angle_min_rad,
                "angle_step": laser.angle_step_rad,
                "range_max": laser.range_max_m,
                "stamp_ns": laser.stamp_ns,
                "upside_down": upside_down,
            }
            pose = tick.odometry[0].odom_from_robot
            mcl.update(Reading(pose, **scan, laser="rear"))
            mcl.update(Reading(pose, **scan, laser="front"))
        assert mcl.belief is not None
        assert mcl.belief.step > 2
        assert len(mcl.belief.scan.others) == 1
        places.append(mcl.belief.hypotheses[0].pose)
    assert places[0] == pytest.approx(places[1], abs=1e-3)


def test_a_belief_draws_itself(readings: list[Reading]) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    belief = believed(mcl, readings[:40])[-1]
    assert belief._repr_png_().startswith(b"\x89PNG")
    empty = np.asarray(belief.picture())
    assert len(np.unique(empty.reshape(-1, 3), axis=0)) > 10
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pyplot = pytest.importorskip("matplotlib.pyplot", reason="the extra plots is missing")
        pyplot.switch_backend("agg")
        axes = belief.plot()
    assert axes.get_xlim()[0] == pytest.approx(belief.map.map_from_grid[0], abs=1.0)
    pyplot.close("all")


def test_every_public_name_is_there() -> None:
    for name in clustermcl.__all__:
        assert getattr(clustermcl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'Nonsense'"):
        clustermcl.Nonsense  # noqa: B018 - to see it refused


def test_importing_the_library_imports_no_heavy_modules() -> None:
    """0.25 s are asked; without Zenoh, numba and numpy it is a few milliseconds."""
    heavy = {"zenoh", "numba", "numpy", "scipy", "msgspec", "typer"}
    assert heavy & modules_after("import clustermcl") == set()
    assert "zenoh" not in modules_after("from clustermcl import ClusterMCL")


def modules_after(line: str) -> set[str]:
    code = f"import sys; {line}; print(*sys.modules)"
    command = [sys.executable, "-I", "-c", code]
    ran = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(ran.stdout.split())
