import re
from pathlib import Path
from typing import Any

import pytest

from clustermcl.protocol.answers import Configure, SetPose
from clustermcl.protocol.errors import InputFileError, SettingsError
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.ros2.nav2_params import read_nav2_params
from clustermcl.ros2.parameter_table import PARAMETERS
from clustermcl.ros2.parameters import Parameters
from clustermcl.ros2.port import State
from clustermcl.ros2.sides import EngineStatus
from clustermcl.ros2.topics import Topics
from clustermcl.runtime.settings import Ros2Settings, Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.settings_table import value_of
from tests.unit.ros2.ports import belief, port
from tests.unit.ros2.test_floors import on

PAGE = Path(__file__).parents[3] / "docs" / "ros2.md"


def test_every_parameter_has_a_setting_that_converts_back_or_a_reason_as_the_page_says() -> None:
    table = re.findall(r"^\| (`.*?) \| (.*) \|$", PAGE.read_text(), re.MULTILINE)
    rows = {name: here for names, here in table for name in re.findall(r"`([\w.]+)`", names)}
    assert len(PARAMETERS) >= 46
    for name, parameter in PARAMETERS.items():
        assert bool(parameter.setting) != bool(parameter.reason), name
        value = parameter.value(Settings())
        assert type(value) is type(parameter.default), name
        if parameter.setting:
            ours = value_of(Settings(), parameter.setting)
            assert parameter.converted(value) == pytest.approx(ours), name
        assert (f"`{parameter.setting}`" if parameter.setting else parameter.reason) in rows[name]


# --- a file of nav2


def write(folder: Path, text: str) -> Path:
    path = folder / "nav2_params.yaml"
    path.write_text(text)
    return path


STOCK = """
amcl:
  ros__parameters:
    alpha1: 0.25
    base_frame_id: "base_link"
    beam_skip_distance: 0.5
    laser_max_range: -1
    laser_model_type: "likelihood_field_prob"
    max_beams: 90
    pf_err: 0.01
    robot_model_type: "nav2_amcl::OmniMotionModel"
    save_pose_rate: 0.5
    transform_tolerance: 2
    update_min_d: 3e-1
    initial_pose: {x: 1.0, y: -2, z: 0.0, yaw: 0.5}
    invented: 3
bt_navigator:
  ros__parameters:
    global_frame: other
"""


def test_a_stock_nav2_file_is_read_unchanged(tmp_path: Path) -> None:
    values, notes = read_nav2_params(write(tmp_path, STOCK))
    settings = load_settings(None, ["ros2.initial_x_m=7"], beneath=values)
    motion, sensor = settings.motion, settings.sensor
    assert (motion.turn_noise_per_turn, motion.model) == (0.5, "omnidirectional")
    assert sensor.max_beams == 90
    assert sensor.max_range_m == Settings().sensor.max_range_m
    assert settings.bridge.gate_distance_m == 0.3
    assert settings.ros2 == Ros2Settings(
        base_frame="base_link",
        transform_tolerance_s=2.0,
        initial_x_m=7.0,
        initial_y_m=-2.0,
        initial_heading_rad=0.5,
        laser_max_range_m=-1.0,  # the laser's own
    )
    assert notes == [  # and nothing of what is as nav2 has it by itself
        f"laser_model_type has no effect: {PARAMETERS['laser_model_type'].reason}",
        f"pf_err has no effect: {PARAMETERS['pf_err'].reason}",
        "invented has no effect: AMCL has no such parameter",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "robot1:\n  amcl:\n    ros__parameters: {max_beams: 90}\n",
        "/robot1/amcl:\n  ros__parameters: {max_beams: 90}\n",
        "/**:\n  ros__parameters: {max_beams: 10}\namcl:\n  ros__parameters: {max_beams: 90}\n",
        "amcl:\n  ros__parameters: {max_beams: 10}\n/**:\n  ros__parameters: {max_beams: 90}\n",
        "/**:\n  ros__parameters: {max_beams: 90}\n",
        "/*:\n  ros__parameters: {laser_max_beams: 90}\n",
        "amcl:\n  ros__parameters: {laser_max_beams: 10, max_beams: 90}\n",
    ],
)
def test_a_node_is_found_in_any_namespace_and_the_last_value_counts(
    tmp_path: Path, text: str
) -> None:
    assert read_nav2_params(write(tmp_path, text))[0]["sensor.max_beams"] == 90


@pytest.mark.parametrize(
    ("model", "ours"),
    [("differential", "differential"), ("omnidirectional", "omnidirectional"),
     ("omni-corrected", "omnidirectional"), ("nav2_amcl::OmniMotionModel", "omnidirectional")],
)  # fmt: skip
def test_old_names_of_models_mean_those_of_nav2(tmp_path: Path, model: str, ours: str) -> None:
    text = f"amcl:\n  ros__parameters: {{robot_model_type: {model}}}\n"
    assert read_nav2_params(write(tmp_path, text))[0]["motion.model"] == ours


def test_names_of_ros_1_are_read_with_a_note(tmp_path: Path) -> None:
    text = (
        "amcl:\n  ros__parameters: {odom_alpha1: 0.25, odom_model_type: diff, laser_z_hit: 0.9}\n"
    )
    values, notes = read_nav2_params(write(tmp_path, text))
    assert values["motion.turn_noise_per_turn"] == 0.5
    assert (values["motion.model"], values["sensor.hit_weight"]) == ("differential", 0.9)
    assert notes[0] == "odom_alpha1 of ROS 1 is read as alpha1"
    assert len(notes) == 3


def test_several_scan_topics_are_a_list_or_separated_by_commas(tmp_path: Path) -> None:
    for value in ("[front/scan, /rear]", "'front/scan,/rear'"):
        text = f"amcl:\n  ros__parameters: {{scan_topic: {value}}}\n"
        ros2 = load_settings(None, [], beneath=read_nav2_params(write(tmp_path, text))[0]).ros2
        assert [topic.name for topic in Topics(ros2).scans] == ["front/scan", "/rear"]
    with pytest.raises(SettingsError, match="scan_topic = ' , ': name a topic"):
        Topics(Ros2Settings(scan_topic=" , "))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a: [", "not YAML"),
        ("- 1", "it is not a mapping"),
        ("a: &a {b: 1}\namcl: {ros__parameters: *a}", r":2: YAML aliases \(\*\) are not read"),
        ("planner:\n  ros__parameters: {x: 1}\n", "it has those of: planner"),
    ],
)
def test_an_invalid_parameter_file_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(InputFileError, match=problem):
        read_nav2_params(write(tmp_path, text))


@pytest.mark.parametrize(
    ("parameter", "problem"),
    [
        ("max_beams: many", "max_beams = 'many': nav2 expects an integer"),
        ("tf_broadcast: 1", "tf_broadcast = 1: nav2 expects true or"),
        ("alpha1: -0.2", "alpha1 = -0.2: a variance must not be neg"),
        ("odom_frame_id: null", "odom_frame_id = None: nav2 expects"),
        ("robot_model_type: my::MotionModel", "nav2 has nav2_amcl::DifferentialMotionModel, nav2"),
        ("base_frame_id: $(var base)", "only ROS's launch files can replace"),
        ("scan_topic: <robot_namespace>/scan", "<robot_namespace>: w"),
        ("scan_topic: [1]", r"scan_topic = \[1\]: nav2 expects a string"),
    ],
)
def test_an_invalid_parameter_is_refused(tmp_path: Path, parameter: str, problem: str) -> None:
    text = f"amcl:\n  ros__parameters: {{{parameter}}}\n"
    with pytest.raises(InputFileError, match=problem):
        read_nav2_params(write(tmp_path, text))


def test_a_value_out_of_its_range_is_refused_with_the_file(tmp_path: Path) -> None:
    path = write(tmp_path, "amcl:\n  ros__parameters: {max_beams: 0}\n")
    with pytest.raises(SettingsError, match=r"nav2_params.yaml: sensor.max_beams = 0"):
        load_settings(None, [], beneath=read_nav2_params(path)[0], beneath_from=str(path))


# --- while the node runs


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("publish", "all", "expected"),
        ("publish", None, "publish = None: nav2 expects a string"),
        ("transform_tolerance", -1.0, "ros2.transform_tolerance_s"),
        ("max_beams", 0, "max_beams: sensor.max_beams = 0: expected"),
        ("alpha1", -0.1, "alpha1 = -0.1: a variance must not be negative"),
        ("scan_topic", "a", "ros2.scan_topic is read only at the start"),
        ("pf_err", 9.0, PARAMETERS["pf_err"].reason),
    ],
)
def test_a_parameter_that_cannot_be_set_is_refused_with_a_reason(
    name: str, value: object, reason: str
) -> None:
    parameters = Parameters(Settings())
    assert reason in parameters.set({name: value})
    assert parameters.settings == Settings()


def test_parameters_set_together_are_all_set_or_none() -> None:
    tested, kept = port()
    assert "ros2.transform_tolerance_s" in tested.set_parameters(
        {"publish": "best", "alpha1": 0.25, "transform_tolerance": -1.0}
    )
    assert tested.parameters.settings == Settings()
    unchanged = {"max_particles": 2000}
    assert tested.set_parameters({"publish": "best", "initial_pose.x": 3.0, **unchanged}) == ""
    assert tested.parameters.settings.ros2 == Ros2Settings(publish="best", initial_x_m=3.0)
    assert kept.commands == []


def test_after_a_reset_the_initial_pose_is_the_last_pose() -> None:
    settings = Ros2Settings(set_initial_pose=True, initial_x_m=1.0, initial_floor="ground")
    tested, kept = port(Settings(ros2=settings))

    def given() -> list[Any]:
        poses = [(one.pose, one.floor) for one in kept.commands if isinstance(one, SetPose)]
        kept.log.clear()
        return poses

    tested.enter(State.ACTIVE)
    assert given() == [((1.0, 0.0, 0.0), "ground")]
    tested.on_belief(on(("third", 0.97)))
    tested.enter(State.INACTIVE)
    assert kept.shown == {}
    tested.enter(State.UNCONFIGURED)
    assert kept.shown == {"initial_pose.x": 5.0, "initial_pose.y": -3.0, "initial_pose.yaw": 0.5}
    tested.enter(State.ACTIVE)
    assert given() == [((5.0, -3.0, 0.5), "third")]
    assert tested.parameters.settings.ros2.initial_x_m == 5.0
    assert kept.bonds == [True, False, True]


@pytest.mark.parametrize("is_set", [True, False])
def test_a_reset_sets_no_initial_pose_without_a_pose_or_set_initial_pose(is_set: bool) -> None:
    settings = Settings(ros2=Ros2Settings(set_initial_pose=is_set, initial_x_m=1.0))
    tested, kept = port(settings)
    tested.enter(State.ACTIVE)
    if not is_set:
        tested.on_belief(belief(10**9, (1, 0.95, (5.0, -3.0, 0.5)), state="localized"))
    tested.enter(State.INACTIVE)
    tested.enter(State.UNCONFIGURED)
    assert (tested.parameters.settings, kept.shown) == (settings, {})


NAV2_LIVE = ("update_min_d", "update_min_a", "sigma_hit", "z_hit", "z_rand")
NAV2_LIVE += tuple(f"alpha{number}" for number in range(1, 6))
NAV2_LIVE += ("max_beams", "laser_min_range", "laser_max_range", "transform_tolerance")


@pytest.mark.parametrize("name", NAV2_LIVE)
def test_parameters_that_nav2_changes_while_driving_can_be_set(name: str) -> None:
    tested, kept = port()
    value, parameter = 31 if name == "max_beams" else 0.25, PARAMETERS[name]
    assert tested.set_parameters({name: value}) == ""
    assert parameter.value(tested.parameters.settings) == pytest.approx(value)
    if not parameter.setting.startswith("ros2."):
        setting = parameter.setting.rpartition(".")[2]
        live = LiveSettings(**{setting: parameter.converted(value)})
        assert kept.commands == [Configure(sender="amcl", settings=live)]


def test_all_live_settings_are_sent_together_and_again_to_an_engine_without_them() -> None:
    tested, kept = port()
    tested.set_parameters({"alpha1": 0.25})
    tested.set_parameters({"max_beams": 60})
    live = LiveSettings(turn_noise_per_turn=0.5, max_beams=60)
    assert kept.commands[1:] == [Configure(sender="amcl", settings=live)]
    tested.set_parameters({"tf_broadcast": False})
    tested.on_status(None)
    tested.on_status(EngineStatus("localized", "fresh", 5, 2, live))
    assert len(kept.commands) == 2
    tested.on_status(EngineStatus("localized", "fresh", 5, 2, LiveSettings()))
    assert kept.commands[1:] == 2 * [Configure(sender="amcl", settings=live)]
