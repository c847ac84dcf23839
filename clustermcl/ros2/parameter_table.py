"""AMCL's parameters in nav2, and the setting of each here, or the reason why it has none."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_table import value_of

Value: TypeAlias = bool | int | float | str

_OWN_BEAM_SKIP = "the sensor model handles unmapped obstacles"
_OWN_MEMORY = "coordinator.state_folder keeps the state"
_ROS_ONLY = "it configures ROS's own middleware"


@dataclass(frozen=True)
class Parameter:
    """A parameter of AMCL."""

    name: str
    default: Value
    """nav2's; it also determines the type."""
    setting: str = ""
    """Dotted name of our setting; empty: there is none, for a `reason`."""
    to_setting: Callable[[Any], Value | None] = lambda value: value
    """See `converted`, which has checked the type."""
    from_setting: Callable[[Any], Value] = lambda value: value
    reason: str = ""
    many: bool = False
    """A list of strings is accepted too."""

    def converted(self, value: object) -> Value | None:
        """Return the setting's value; None: leave our setting unchanged.

        Raises:
            ValueError: nav2 does not accept the value.
        """
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        kind = type(self.default)
        if self.many and isinstance(value, list) and all(isinstance(one, str) for one in value):
            value = ", ".join(value)
        if isinstance(value, str) and (left := _LEFT_TO_LAUNCH.search(value)):
            problem = f"only ROS's launch files can replace {left[0]}: write the value itself"
            raise ValueError(problem)
        if not (is_number if kind is float else type(value) is kind):
            raise ValueError(f"nav2 expects {_KINDS[kind]}")
        return self.to_setting(value)

    @property
    def description(self) -> str:
        return self.setting or f"without effect: {self.reason}"

    @property
    def is_live(self) -> bool:
        is_own = self.setting.startswith("ros2.") and self.setting not in _AT_START
        return is_own or self.live_name is not None

    @property
    def live_name(self) -> str | None:
        """The field of `LiveSettings`; None: it is not a live setting of other processes."""
        key = self.setting.rpartition(".")[2]
        return key if key in LiveSettings.__struct_fields__ else None

    def value(self, settings: Settings) -> Value:
        if not self.setting:
            return self.default
        value = self.from_setting(value_of(settings, self.setting))
        return float(value) if isinstance(self.default, float) else value


_AT_START = (
    "ros2.autostart", "ros2.base_frame", "ros2.global_frame", "ros2.map_topic", "ros2.odom_frame",
    "ros2.scan_topic",
)  # fmt: skip
_LEFT_TO_LAUNCH = re.compile(r"\$\(.*|<\w+>")
_KINDS = {bool: "true or false", int: "an integer", float: "a number", str: "a string"}
_MOTION_MODELS = {
    "nav2_amcl::DifferentialMotionModel": "differential",
    "nav2_amcl::OmniMotionModel": "omnidirectional",
    "differential": "differential", "omnidirectional": "omnidirectional",  # until Galactic
    "diff": "differential", "diff-corrected": "differential",  # of ROS 1
    "omni": "omnidirectional", "omni-corrected": "omnidirectional",
}  # fmt: skip


def _our_motion_model(model: str) -> str:
    if model not in _MOTION_MODELS:
        raise ValueError(f"nav2 has {', '.join(_MOTION_MODELS)}")
    return _MOTION_MODELS[model]


def _nav2_motion_model(model: str) -> str:
    return next(plugin for plugin, ours in _MOTION_MODELS.items() if ours == model)


def _root(variance: float) -> float:
    if variance < 0.0:
        raise ValueError("a variance must not be negative")
    return math.sqrt(variance)


def _alpha(number: int, default: float, ours: str) -> Parameter:
    """Return the parameter `alphaN` of nav2, a variance; our setting is its square root."""
    setting = f"motion.{ours}"
    return Parameter(
        f"alpha{number}", default, setting, _root, lambda value: round(value * value, 12)
    )


def _without(reason: str, **parameters: Value) -> tuple[Parameter, ...]:
    return tuple(Parameter(name, value, reason=reason) for name, value in parameters.items())


_ALL = (
    _alpha(1, 0.2, "turn_noise_per_turn"),
    _alpha(2, 0.2, "turn_noise_per_metre"),
    _alpha(3, 0.2, "drive_noise_per_metre"),
    _alpha(4, 0.2, "drive_noise_per_turn"),
    _alpha(5, 0.2, "strafe_noise_per_metre"),
    Parameter("always_reset_initial_pose", False, "ros2.always_reset_initial_pose"),
    Parameter("autostart_node", False, "ros2.autostart"),
    Parameter("base_frame_id", "base_footprint", "ros2.base_frame"),
    Parameter("first_map_only", False, "ros2.first_map_only"),
    Parameter("global_frame_id", "map", "ros2.global_frame"),
    Parameter("initial_pose.x", 0.0, "ros2.initial_x_m"),
    Parameter("initial_pose.y", 0.0, "ros2.initial_y_m"),
    Parameter("initial_pose.yaw", 0.0, "ros2.initial_heading_rad"),
    Parameter("laser_likelihood_max_dist", 2.0, "sensor.max_obstacle_distance_m"),
    Parameter("laser_max_range", 100.0, "ros2.laser_max_range_m"),
    Parameter("laser_min_range", -1.0, "ros2.laser_min_range_m"),
    Parameter("map_topic", "map", "ros2.map_topic"),
    Parameter("max_beams", 60, "sensor.max_beams"),
    Parameter("odom_frame_id", "odom", "ros2.odom_frame"),
    Parameter("random_seed", -1, "seed", lambda value: value if value >= 0 else None),
    Parameter(
        "robot_model_type",
        "nav2_amcl::DifferentialMotionModel",
        "motion.model",
        _our_motion_model,
        _nav2_motion_model,
    ),
    Parameter("scan_topic", "scan", "ros2.scan_topic", many=True),
    Parameter("set_initial_pose", False, "ros2.set_initial_pose"),
    Parameter("sigma_hit", 0.2, "sensor.hit_sigma_m"),
    Parameter("tf_broadcast", True, "ros2.tf_broadcast"),
    Parameter("transform_tolerance", 1.0, "ros2.transform_tolerance_s"),
    Parameter("update_min_a", 0.2, "bridge.gate_turn_rad"),
    Parameter("update_min_d", 0.25, "bridge.gate_distance_m"),
    Parameter("z_hit", 0.5, "sensor.hit_weight"),
    Parameter("z_rand", 0.5, "sensor.random_weight"),
    *_without(
        "all places share belief.particles",
        max_particles=2000,
        min_particles=500,
        pf_err=0.05,
        pf_z=0.99,
    ),
    *_without(
        "searches replace random particles", recovery_alpha_fast=0.0, recovery_alpha_slow=0.0
    ),
    *_without(
        "the sensor model is the likelihood field, which multiplies the beams' probabilities",
        laser_model_type="likelihood_field",
    ),
    *_without("only AMCL's beam model uses it", lambda_short=0.1, z_max=0.05, z_short=0.05),
    *_without("resampling depends on cluster.resample_below_ess", resample_interval=1),
    *_without(_OWN_BEAM_SKIP, do_beamskip=False, beam_skip_distance=0.5),
    *_without(_OWN_BEAM_SKIP, beam_skip_threshold=0.3, beam_skip_error_threshold=0.9),
    *_without(
        _OWN_MEMORY, initialize_at_saved_pose=False, save_pose_rate=0.5, saved_pose_filepath=""
    ),
    Parameter("initial_pose.z", 0.0, reason="the robot drives in a plane"),
    Parameter("freespace_downsampling", False, reason="the whole map is searched"),
    *_without(_ROS_ONLY, bond_heartbeat_period=0.1, introspection_mode="disabled"),
    *_without(_ROS_ONLY, service_introspection_mode="disabled"),
    Parameter("publish", "held", "ros2.publish"),
)

ROS1_NAMES = {
    **{f"odom_alpha{number}": f"alpha{number}" for number in range(1, 6)},
    **{f"laser_{name}": name for name in ("max_beams", "sigma_hit", "lambda_short")},
    **{f"laser_z_{name}": f"z_{name}" for name in ("hit", "max", "rand", "short")},
    "initial_pose_x": "initial_pose.x", "initial_pose_y": "initial_pose.y",
    "initial_pose_a": "initial_pose.yaw",
    "kld_err": "pf_err", "kld_z": "pf_z", "odom_model_type": "robot_model_type",
}  # fmt: skip
"""nav2's name for each parameter of ROS 1's AMCL that has another one."""

PARAMETERS = {parameter.name: parameter for parameter in sorted(_ALL, key=lambda one: one.name)}
"""All parameters by name; nav2 lacks `publish`."""
