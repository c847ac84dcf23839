"""Commands of clients: the robot's pose, and the start of a search."""

import math
from typing import Annotated

import msgspec
from msgspec.structs import replace

from clustermcl.belief.dead_reckoning import carried
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.free_ground import FreeGround
from clustermcl.belief.given_places import candidate, diagonal
from clustermcl.belief.outcome import Outcome
from clustermcl.belief.part import FEW, Count, Part, Text
from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.filter.random_streams import Purpose
from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.errors import printable
from clustermcl.protocol.floors import ONE_MAP
from clustermcl.protocol.job_events import MAX_DETAIL_CHARACTERS, Remark
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.steps import Scan

KEPT_COMMANDS = 20
"""Number of commands whose answers are kept, because a client may repeat a command."""


class Commanded(msgspec.Struct, frozen=True):
    """A command with the odometry at its stamp."""

    command: SetPose | Relocalize
    stamp_ns: int = 0
    odom_from_robot: PoseTuple | None = None
    """None: no odometry had arrived; the robot is assumed to have stood still until the first."""
    during_search: bool = False
    """Whether the first search had begun when the command arrived."""


class Commands(Part):
    """Carries out each command once, however often it is repeated."""

    problems: Annotated[dict[Text, Text], FEW] = {}
    """Why each of the last commands was refused, by command id; empty: it was not refused."""
    set_poses: Count = 0
    """Number of given poses, which selects the random stream of each."""
    waiting: Commanded | None = None
    """A command from before the first step, or a pose from before the map."""

    def resume(self, handed_on: "Commands") -> None:
        """Continue from another coordinator's commands, and keep those of this one."""
        self.problems = self.problems | handed_on.problems
        self.set_poses = handed_on.set_poses
        self.waiting = handed_on.waiting or self.waiting

    @property
    def forgets(self) -> bool:
        """Whether the first search must not use the robot's last pose."""
        waiting = self.waiting
        return waiting is not None and isinstance(waiting.command, Relocalize)

    def carry_out(
        self,
        command: SetPose | Relocalize,
        ensemble: Ensemble,
        applied: Scan | None,
        odometry: Trajectory,
        ground: FreeGround | None,
    ) -> Outcome | None:
        """Carry out a command after the last applied scan.

        A command before the first step, and a pose before the map, wait for `carry_out_waiting`.
        The newest command replaces a waiting one.

        Args:
            command: command with a new id.
            ensemble: the belief, which is changed.
            applied: the scan of the last step; None: no step was applied.
            odometry: the robot's motion, to carry a pose to that step.
            ground: where a robot can be; None: the map has not arrived.

        Returns:
            The new belief; None: the command waits or was refused.
        """
        commanded, problem = _with_odometry(command, odometry)
        problem = problem or _ground_problem(command, ground)
        self._remember(command, problem)
        if problem:
            return None
        if applied is None or _needs_map(command, ground):
            self.waiting = replace(commanded, during_search=ensemble.searches > 0)
            return None
        return self._outcome(commanded, ensemble, applied, ground)

    def carry_out_waiting(
        self, ensemble: Ensemble, applied: Scan, odometry: Trajectory, ground: FreeGround | None
    ) -> Outcome | str | None:
        """Carry out the waiting command, if the map allows a decision.

        A search that was requested before the first search began needs no action: the first search
        is that one.

        Returns:
            The new belief, or why the command is refused; None: nothing was done.
        """
        waiting = self.waiting
        if waiting is None or _needs_map(waiting.command, ground):
            return None
        self.waiting = None
        if problem := _ground_problem(waiting.command, ground):
            self._remember(waiting.command, problem)
            return problem
        if isinstance(waiting.command, Relocalize) and not waiting.during_search:
            return None
        if waiting.odom_from_robot is None and (oldest_ns := odometry.oldest_ns) is not None:
            waiting = Commanded(waiting.command, oldest_ns, odometry.pose_at(oldest_ns))
        return self._outcome(waiting, ensemble, applied, ground)

    def _outcome(
        self, commanded: Commanded, ensemble: Ensemble, applied: Scan, ground: FreeGround | None
    ) -> Outcome:
        floors = ground.floors if ground else ONE_MAP  # a command that names a floor has waited
        if isinstance(commanded.command, Relocalize):
            near, corners = floors.area(commanded.command.floor, commanded.command.near)
            return ensemble.relocalize(applied.step, near=near, corners=corners)
        self.set_poses += 1
        given, settings = commanded.command, ensemble.settings
        mean, covariance = floors.in_atlas(given.floor, given.pose), _covariance(given)
        if commanded.odom_from_robot is not None:
            # Motion to the step makes a pose less certain. A pose of a later time is carried back
            # without noise, because the next step adds the noise.
            is_earlier = commanded.stamp_ns < applied.stamp_ns
            mean, covariance = carried(
                mean,
                covariance,
                commanded.odom_from_robot,
                applied.odom_from_robot,
                settings.motion if is_earlier else None,
            )
        place = candidate(
            settings.belief.set_pose_probability,
            mean,
            covariance,
            seed=settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self.set_poses,
            step=applied.step,
            odom_from_robot=applied.odom_from_robot,
        )
        return ensemble.set_pose(place)

    def _remember(self, command: SetPose | Relocalize, problem: str) -> None:
        known = self.problems | {command.command_id: problem}
        self.problems = dict(list(known.items())[-KEPT_COMMANDS:])


def command_remark(command: SetPose | Relocalize, problem: str = "") -> Remark:
    """Return a command in words, with its sender and the reason if it was refused."""
    match command:
        case SetPose(pose=(x, y, heading)):
            sigma_m = math.sqrt(max(_covariance(command)[0], _covariance(command)[4]))
            cause, what = (
                "pose given",
                (
                    f"x {x:.2f} m  y {y:.2f} m  heading {math.degrees(heading):.1f} deg  "
                    f"+-{sigma_m:.2f} m"
                ),
            )
        case Relocalize(near=None):
            cause, what = "search requested", ""
        case Relocalize(near=(x, y, radius)):
            cause, what = "search requested", f"within {radius:g} m of x {x:.2f} m  y {y:.2f} m"
    refused = f"refused: {problem}" if problem else ""
    floor = f"floor {printable(command.floor)}" if command.floor else ""
    parts = (floor, what, f"by {printable(command.sender)}", refused)
    return Remark(cause=cause, detail=", ".join(filter(None, parts))[:MAX_DETAIL_CHARACTERS])


def _with_odometry(command: SetPose | Relocalize, odometry: Trajectory) -> tuple[Commanded, str]:
    """Return a command with the odometry at its stamp, and the reason if it is refused."""
    oldest_ns, newest_ns = odometry.oldest_ns, odometry.newest_ns
    if isinstance(command, Relocalize) or oldest_ns is None or newest_ns is None:
        return Commanded(command), ""
    stamp_ns = newest_ns if command.stamp_ns is None else min(command.stamp_ns, newest_ns)
    odom_from_robot = odometry.pose_at(stamp_ns)
    if odom_from_robot is None:
        ago_s = (oldest_ns - stamp_ns) / 1e9
        problem = f"the pose is of {ago_s:.1f} s before the oldest odometry that is known; "
        if ago_s < 0.0:
            problem = "odometry is missing for that time; "
        return Commanded(command), problem + "give a newer one, or one without a stamp"
    return Commanded(command, stamp_ns, odom_from_robot), ""


def _needs_map(command: SetPose | Relocalize, ground: FreeGround | None) -> bool:
    return ground is None and (isinstance(command, SetPose) or bool(command.floor))


def _ground_problem(command: SetPose | Relocalize, ground: FreeGround | None) -> str:
    match ground, command:
        case None, _:
            return ""
        case FreeGround(), SetPose():
            return ground.problem_of(command.pose, _covariance(command), command.floor) or ""
        case FreeGround(floors=floors), Relocalize(floor=floor):
            try:
                if floor or (floors and command.near is not None):
                    floors.floor(floor)
            except ValueError as error:
                return str(error)
    return ""


def _covariance(given: SetPose) -> Covariance:
    return given.covariance or diagonal(given.position_sigma_m, given.heading_sigma_rad)
