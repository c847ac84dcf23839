"""The library: the beliefs of `evaluate`, from plain numpy arrays."""

import sys
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

import clustermcl
from clustermcl import (
    Belief,
    ClusterMCL,
    ClusterMclError,
    CommandRefusedError,
    GridMap,
    Reading,
    SettingsError,
    SimulatedRobot,
    load_map,
    read_recording,
)
from clustermcl.protocol.steps import LaserReading
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
    best, last = expected[-1].hypotheses[0], beliefs[-1]
    assert (best.x_m, best.y_m, best.heading_rad) == (last.x_m, last.y_m, last.heading_rad)
    assert last.covariance is not None
    assert tuple(last.covariance.ravel()) == best.covariance


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


def test_no_field_of_a_recorded_reading_is_lost(tmp_path: Path) -> None:
    log = tmp_path / "robot.log"
    log.write_text(logs.robot_laser(1.0, (1.0, 2.0, 3.0), (0.1, 0, 0), (0, 0, 0)) + "\n")
    mount = bags.fixed_tf("base_link", "laser", (0.2, 0.0, 0.1))
    moves = [bags.tf(at, "odom", "base_link", (1.0, 2.0, 0.0)) for at in (10, 20)]
    bag = bags.written(tmp_path, "mcap", [mount, moves[0], bags.scan(10), moves[1]])
    for path in (log, bag):
        expected = open_recording(path, BridgeSettings()).readings
        assert expected, path
        read = [reading.as_message(0, (9.0, 9.0, 9.0)) for reading in read_recording(path)]
        assert read == [msgspec.structs.replace(one, sender="library") for one in expected], path


def scan_of(laser: LaserReading) -> dict[str, Any]:
    return {
        "ranges": laser.ranges.array(), "angle_min": laser.angle_min_rad,
        "angle_step": laser.angle_step_rad, "range_max": laser.range_max_m,
    }  # fmt: skip


def test_readings_of_arrays_give_beliefs_and_a_standing_robot_gives_none() -> None:
    hall, small = world("hall"), {"cluster.particles": 300, "search.poses": 4_000}
    mcl = ClusterMCL(hall.map, robot_from_laser=(0.1, 0.0, 0.0), seed=1, settings=small)
    scan = scan_of(next(iter(Simulation(hall, 0))).laser)
    for odometry, step in (((0.0, 0.0, 0.0), 0), (np.zeros(3), 0), ([0.3, 0.0, 0.0], 1)):
        mcl.update(Reading(odometry, **scan))
        assert mcl.belief is not None
        assert mcl.belief.step == step
    assert mcl.update(Reading(np.array([0.3, 0.0, 0.0]), **scan), force=True)
    assert mcl.belief.scan.robot_from_laser == (0.1, 0.0, 0.0)


ZERO, ONES = (0.0, 0.0, 0.0), np.ones(181)
SCAN: dict[str, Any] = {"ranges": ONES, "angle_min": -1.57, "angle_step": 0.0175, "range_max": 30.0}


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({}, "a scan, odometry, or both"),
        ({"odom_from_robot": (0, 0)}, r"is x, y, heading, not of shape \(2,\)"),
        ({"odom_from_robot": (1.0, np.nan, 0.0)}, r"odom_from_robot \(1.0, nan, 0.0\)"),
        ({**SCAN, "ranges": np.ones((2, 2))}, r"shape \(2, 2\), expected \(B,\)"),
        ({**SCAN, "ranges": []}, r"shape \(0,\), expected \(B,\)"),
        ({**SCAN, "angle_min": -90.0}, "angle_min is -90.* radians"),
        ({**SCAN, "angle_step": 1.0}, "angle_step times 180 is 178.* radians"),
        ({**SCAN, "angle_step": 0.0}, "angle_step is 0, but there are 181"),
        ({**SCAN, "angle_min": np.nan}, "angle_min is nan"),
        ({"ranges": ONES, "angle_step": 0.01}, "range_max is 0.0"),
        ({**SCAN, "range_min": 40.0}, "range_min is 40.0, range_max 30.0"),
        ({**SCAN, "stamp_ns": 12.5}, "stamp_ns is 12.5: give whole nanoseconds"),
        ({**SCAN, "robot_from_laser": (0.2, 0.0, 90.0)}, "robot_from_laser is 90, .*radians"),
    ],
)
def test_a_number_that_is_never_right_is_refused(wrong: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Reading(**wrong)


def test_wrong_arguments_are_refused_in_a_sentence() -> None:
    hall: Any = world("hall").map
    mcl: Any = ClusterMCL(hall, settings=SMALL)
    millimetres = {**SCAN, "ranges": 1000.0 * ONES, "range_max": 30_000.0}
    with pytest.raises(ValueError, match=r"nearest range is 1000 m, but the map .* give metres"):
        mcl.update(Reading(ZERO, **millimetres))
    with pytest.raises(ValueError, match=r"the heading of pose is 90, .* give radians"):
        mcl.set_pose((0.0, 0.0, 90.0))
    with pytest.raises(ValueError, match=r"covariance has shape \(2, 2\)"):
        mcl.set_pose(ZERO, covariance=np.eye(2))
    with pytest.raises(ValueError, match="the heading of mean is -90"):
        mcl.observe((0.0, 0.0, -90.0), np.eye(3))
    with pytest.raises(ValueError, match="not positive definite"):
        mcl.observe((1.0, 0.0), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="robot_from_laser"):
        ClusterMCL(hall, robot_from_laser=(0.0, 0.0, 180.0))
    with pytest.raises(TypeError, match=r"update takes a Reading, not dict: \{'ranges"):
        mcl.update({"ranges": []})
    for wrong in ({"belief.max_cluster": 8}, {"belief": 8}, {"belief.max_clusters": 0}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            ClusterMCL(hall, settings=wrong)
    for call in (ClusterMCL, mcl.change_map):
        with pytest.raises(TypeError, match=r"'map.yaml', a str: give .* load_map\('map.yaml'\)"):
            call("map.yaml")
    for wrong in ({"settings": "robot.toml"}, {"landmarks": "landmarks.yaml"}):
        with pytest.raises(TypeError, match="a str: give"):
            ClusterMCL(hall, **wrong)
    with pytest.raises(ValueError, match="near is x, y and a radius"):
        mcl.relocalize((1.0, 2.0))
    assert (mcl.belief, mcl.dropped) == (None, {})


def test_what_a_robot_may_send_once_is_counted_and_warned_of_once() -> None:
    mcl = ClusterMCL(world("hall").map, settings=SMALL)
    mcl.update(Reading(ZERO, stamp_ns=10_000_000_000))

    def far(stamp_ns: int) -> None:
        assert mcl.update(Reading(ZERO, **SCAN | {"ranges": 400 * ONES}, stamp_ns=stamp_ns)) is None

    def late(stamp_ns: int) -> None:
        assert mcl.update(Reading(ZERO, stamp_ns=stamp_ns - 5_000_000_000)) is None

    def unknown(_: int) -> None:
        mcl.observe((1.0, 0.0), 0.01 * np.eye(2), landmark="exit")

    for cause, send, said in (
        ("no_returns", far, "no returns, shown once: .*181 ranges of 400.00 to 400.00 m"),
        ("stamp_steps_back", late, "stamp steps back, shown once: .*stamp_ns 5"),
        ("unknown_landmark", unknown, "unknown landmark, shown once: .*'exit' by 'sensor'"),
    ):
        with pytest.warns(UserWarning, match=said) as caught:
            send(10_100_000_000)
        assert caught[0].filename == __file__, "it points to the caller"
        send(10_200_000_000)  # a second warning would be an error
        assert mcl.dropped[cause] == 2
    with pytest.warns(UserWarning, match="full turn, shown once: right only if"):
        mcl.update(Reading((0.0, 0.0, 90.0), stamp_ns=10_300_000_000))


def test_set_pose_and_relocalize_change_the_belief(readings: list[Reading]) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    # Before the first scan: remembered.
    mcl.set_pose(np.zeros(3), covariance=np.diag([0.25, 0.25, 0.07]))
    first = believed(mcl, readings[:20])[0]
    assert first.pose is not None
    assert np.hypot(*first.pose[:2]) < 2.0
    assert first.probability > 0.5
    mcl.relocalize()
    assert mcl.belief is not None
    assert (mcl.belief.state, mcl.belief.hypotheses) == ("searching", ())
    with pytest.raises(CommandRefusedError, match="no floor 'attic'"):
        mcl.relocalize(floor="attic")
    with pytest.raises(CommandRefusedError, match="map"):
        mcl.set_pose((700.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="is invalid"):
        mcl.set_pose(np.zeros(3), position_sigma_m=-1.0)
    with pytest.raises(ValueError, match="there is no pose yet"):
        mcl.belief.x_m  # noqa: B018 - to see it refused


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
            scan = scan_of(tick.laser)
            scan |= {"stamp_ns": tick.laser.stamp_ns, "upside_down": upside_down}
            scan["ranges"] = scan["ranges"][:: -1 if upside_down else 1]
            pose = tick.odometry[0].odom_from_robot
            mcl.update(Reading(pose, **scan, laser="rear"))
            mcl.update(Reading(pose, **scan, laser="front"))
        assert mcl.belief is not None
        assert mcl.belief.step > 2
        assert len(mcl.belief.scan.others) == 1
        places.append(mcl.belief.hypotheses[0].pose)
    assert places[0] == pytest.approx(places[1], abs=1e-3)


def test_a_belief_draws_itself_or_names_the_extra(
    readings: list[Reading], monkeypatch: pytest.MonkeyPatch
) -> None:
    mcl = ClusterMCL(world("cross_feature").map, settings=SMALL)
    belief = believed(mcl, readings[:40])[-1]
    assert belief._repr_png_().startswith(b"\x89PNG")
    axes = belief.plot()
    assert axes.get_xlim()[0] == pytest.approx(belief.map.map_from_grid[0], abs=1.0)
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'clustermcl\[plots\]'"):
        belief.plot()
    assert belief._repr_png_() is None, "a notebook shows its text"


def test_a_map_is_made_of_an_array() -> None:
    occupied = np.zeros((20, 30), bool)
    occupied[0] = True
    grid_map = GridMap.from_array(occupied, 0.1, (1.0, 2.0, 0.0))
    as_in_ros = np.where(occupied, 100, 0).astype(np.int16)
    as_in_ros[5, 5:] = -1
    with_unknown = GridMap.from_array(as_in_ros, 0.1)
    for as_numbers in (occupied, occupied.astype(np.int8), 0.8 * occupied, 80 * occupied):
        assert (GridMap.from_array(as_numbers, 0.1).cells == occupied).all()
    assert (GridMap.from_array(with_unknown.cells, 0.1).cells == with_unknown.cells).all()
    assert (with_unknown.cells[5, 4], with_unknown.cells[5, 5]) == (0, -1)
    assert grid_map.size_m == pytest.approx((3.0, 2.0))
    with pytest.raises(ValueError, match="2-d"):
        GridMap.from_array(np.zeros(4), 0.1)


def test_a_simulated_robot_drives_the_same_way_again_and_is_found() -> None:
    robot, again = (SimulatedRobot("hall", seed=4) for _ in range(2))
    mcl, start = ClusterMCL(robot.map, settings=SMALL), robot.pose
    for reading, same in islice(zip(robot, again, strict=True), 600):
        assert reading.as_message(0, ZERO) == same.as_message(0, ZERO)
        belief = mcl.update(reading)
        if belief and belief.state == "localized" and belief.step > 5:
            break
    assert mcl.belief is not None
    assert mcl.belief.pose is not None
    assert np.hypot(*(mcl.belief.pose - robot.pose)[:2]) < 0.5
    assert np.hypot(*(start - robot.pose)[:2]) > 0.2
    with pytest.raises(ClusterMclError, match="'atlantis'; the worlds are"):
        SimulatedRobot("atlantis")


def test_every_public_name_is_there() -> None:
    for name in clustermcl.__all__:
        assert getattr(clustermcl, name) is not None
    assert clustermcl.__version__ == version("clustermcl")
    with pytest.raises(AttributeError, match="no attribute 'Nonsense'"):
        clustermcl.Nonsense  # noqa: B018 - to see it refused
