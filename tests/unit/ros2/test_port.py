"""What passes between ROS, the node's decisions and the engine."""

from pathlib import Path

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Relocalize, SetPose, Update
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import GONE, MOVED, NEW, Changes
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.protocol.steps import LaserReading, MapReading, OdometryReading
from clustermcl.recordings.rigid import flat
from clustermcl.ros2 import topics
from clustermcl.ros2.bond import BridgeState, RestartFile
from clustermcl.ros2.messages_out import pose_stamped, transform
from clustermcl.ros2.port import SERVICES, Port, State
from clustermcl.ros2.sides import EngineStatus
from clustermcl.runtime.settings import Ros2Settings, Settings
from tests.ros_messages import link, new
from tests.unit.ros2.ports import COVARIANCE, Kept, belief, port
from tests.unit.ros2.test_amcl import SECOND, grid, scan

PLACES = ((1, 0.95, (5.0, -3.0, 0.5)),)


def active(settings: Settings | None = None) -> tuple[Port, Kept]:
    tested, kept = port(settings)
    tested.enter(State.INACTIVE)
    tested.enter(State.ACTIVE)
    mount = link("base_footprint", "laser", flat((0.2, 0.1, 0.3)))
    tested.on_message(topics.TF_STATIC, mount)
    return tested, kept


def test_readings_go_to_the_engine_and_its_belief_to_ros() -> None:
    tested, kept = active()
    names = topics.Topics(Ros2Settings())
    tested.on_message(names.map, grid())
    tested.on_message(topics.TF, transform((0.0, 0.0, 0.0), SECOND, "odom", "base_footprint"))
    tested.on_message(names.scans[0], scan(SECOND))
    assert [type(one) for one in kept.readings] == [MapReading, OdometryReading, LaserReading]
    tested.on_belief(belief(SECOND, *PLACES, state="localized"))
    assert len(kept.on(topics.AMCL_POSE)) == 1
    assert not kept.on(topics.HYPOTHESES)
    tested.tick()
    tested.tick()
    assert len(kept.on(topics.HYPOTHESES)) == 1
    tested.on_message(names.scans[0], scan(SECOND + 1))
    assert not kept.on(topics.TF)  # it waits for odometry of its time
    kept.process_ns += 2 * SECOND
    tested.tick()
    assert dict(kept.refused()) == {"laser scan without transform: transform does not arrive": 1}


def test_changes_of_the_building_are_a_grid_while_the_node_is_active() -> None:
    tested, kept = active()
    seen = Changes(
        sender="b", map_digest="m", stamp_ns=SECOND, cell_m=0.1, rows=2, cols=3,
        map_from_grid=(1.0, 2.0, 0.0),
        cells=ArrayBlob.of([[0, GONE, 5, 1], [4, NEW, 5, 1], [5, MOVED, 5, 3]], "int32"),
        times_s=ArrayBlob.of([[0.0, 1.0]] * 3, "float64"),
    )  # fmt: skip
    tested.on_changes(seen)
    (published,) = kept.on(topics.CHANGES)
    assert list(published.data) == [0, -1, -1, -1, 100, 50]
    assert (published.info.width, published.info.height) == (3, 2)
    assert published.info.origin.position.y == 2.0
    assert published.header.frame_id == "map"
    tested.enter(State.INACTIVE)
    tested.on_changes(seen)
    assert len(kept.on(topics.CHANGES)) == 1


def test_every_service_has_its_response_and_its_effect() -> None:
    tested, kept = active()
    given = pose_stamped((1.0, 2.0, 0.5), COVARIANCE, 0, "map")
    request = new("nav2_msgs/srv/SetInitialPose_Request", pose=given)
    for service in SERVICES:
        tested.call(service, request)
    assert [type(one) for one in kept.commands] == [Relocalize, Update, SetPose]
    assert kept.questions == 1
    tested.on_advice(Advice(sender="engine"))
    assert len(kept.on(topics.ADVICE)) == 1


def test_a_robot_is_localized_only_with_fresh_data() -> None:
    tested, _ = active()
    answer = tested.call("~/is_localized", None)
    assert (answer.success, answer.message) == (False, "searching, unreachable, probability 0.000")
    tested.on_belief(belief(SECOND, *PLACES, state="localized"))
    for freshness, success in (("fresh", True), ("stale", False)):
        tested.on_status(EngineStatus("localized", freshness, 5, 2, LiveSettings()))
        assert tested.call("~/is_localized", None).success is success


def test_diagnostics_come_once_a_second_with_counts_of_what_was_refused() -> None:
    tested, kept = active()
    tested.on_message(topics.INITIAL_POSE, pose_stamped((0, 0, 0), COVARIANCE, 0, "moon"))
    for kept.process_ns in range(0, 3 * SECOND, SECOND // 2):
        tested.tick()
    reported = kept.on(topics.DIAGNOSTICS)
    assert len(reported) == 3
    (status,) = reported[-1].status
    values = {one.key: one.value for one in status.values}
    assert values == {"life cycle": "active", "initial pose refused": "1"}


def test_a_restart_file_that_cannot_be_read_or_written_costs_no_start(tmp_path: Path) -> None:
    kept = RestartFile(str(tmp_path), "x" * 300)  # no file can be called so
    assert kept.read() is None
    kept.keep(BridgeState(state="active", bond="b", held=None), 0.0)
    assert kept.read() is None
