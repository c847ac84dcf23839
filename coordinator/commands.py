"""Commands of persons: the robot's pose, and the start of a search."""

from collections.abc import Mapping
from typing import Annotated

import msgspec
from msgspec.structs import replace

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.given_places import candidate, diagonal
from coordinator.belief.outcome import Outcome
from coordinator.dead_reckoning import carried
from coordinator.free_ground import FreeGround
from coordinator.part import FEW, Count, Part, Text
from particle_filter.random_streams import Purpose
from particle_filter.regions import parsed_regions
from particle_filter.settings import MotionSettings
from particle_filter.trajectory import Trajectory
from protocol.answers import Relocalize, SetPose
from protocol.errors import printable
from protocol.message import Covariance, PoseTuple
from protocol.steps import Scan

KEPT_COMMANDS = 20
"""The answers of the last commands are kept, in case one is repeated."""


class Commanded(msgspec.Struct, frozen=True):
    """A command with the odometry at its time."""

    command: SetPose | Relocalize
    stamp_ns: int = 0
    odom_from_robot: PoseTuple | None = None
    """None: there was none yet; the robot stood until the first."""
    during_search: bool = False
    """The first search had begun already."""


class Commands(Part):
    """Carries out each command once, however often it is repeated."""

    problems: Annotated[dict[Text, Text], FEW] = {}
    """Why each of the last commands was refused, by its id; empty for a command that was done."""
    set_poses: Count = 0
    """Number of given poses; it selects the random stream of each."""
    waiting: Commanded | None = None
    """A command that arrived before the first step, or a pose that arrived before the map."""

    def resume(self, handed_on: "Commands") -> None:
        """Continue from another coordinator's commands, and keep those of this one."""
        self.problems = self.problems | handed_on.problems
        self.set_poses = handed_on.set_poses
        self.waiting = handed_on.waiting or self.waiting

    def problem(self, command_id: str) -> str | None:
        """Return why a command was refused, empty if it was done; None for a new one."""
        return self.problems.get(command_id)

    @property
    def forgets(self) -> bool:
        """Whether the first search must not use a place from earlier knowledge."""
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
        """Do what is commanded, as of the last applied scan.

        A command before the first scan waits for `carry_out_waiting`, and so does a pose before the
        map. Of several, the last counts.

        Args:
            command: with a new id.
            ensemble: carries it out.
            applied: the scan of the last step; None before the first.
            odometry: the robot's motion since a pose was true.
            ground: where a robot can be; None: the map has not arrived yet.

        Returns:
            None if nothing is done now: the command waits, or is refused.
        """
        commanded, problem = _held(command, odometry, ensemble.settings.search.regions)
        problem = problem or _ground_problem(command, ground)
        self._remember(command, problem)
        if problem:
            return None
        if applied is None or not _can_be_judged(command, ground):
            self.waiting = replace(commanded, during_search=ensemble.searches > 0)
            return None
        return self._outcome(commanded, ensemble, applied)

    def carry_out_waiting(
        self,
        ensemble: Ensemble,
        applied: Scan,
        odometry: Trajectory,
        ground: FreeGround | None,
    ) -> Outcome | str | None:
        """Do what was commanded before the first step, or the map, came.

        A search that was asked for before the first one began is that one: it knows of no place.

        Returns:
            Why it is refused, where it is; None: there is nothing to do.
        """
        waiting = self.waiting
        if waiting is None or not _can_be_judged(waiting.command, ground):
            return None
        self.waiting = None
        if problem := _ground_problem(waiting.command, ground):
            self._remember(waiting.command, problem)
            return problem
        if isinstance(waiting.command, Relocalize) and not waiting.during_search:
            return None
        if waiting.odom_from_robot is None and (oldest_ns := odometry.oldest_ns) is not None:
            waiting = Commanded(waiting.command, oldest_ns, odometry.pose_at(oldest_ns))
        return self._outcome(waiting, ensemble, applied)

    def _outcome(self, commanded: Commanded, ensemble: Ensemble, applied: Scan) -> Outcome:
        if isinstance(commanded.command, Relocalize):
            asked = commanded.command
            corners = parsed_regions(ensemble.settings.search.regions).get(asked.region, ())
            return ensemble.relocalize(applied.step, near=asked.near, corners=corners)
        self.set_poses += 1
        settings = ensemble.settings
        mean, covariance = _at_step(commanded, commanded.command, applied, settings.motion)
        given = candidate(
            settings.belief.set_pose_probability,
            mean,
            covariance,
            seed=settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self.set_poses,
            step=applied.step,
            odom_from_robot=applied.odom_from_robot,
        )
        return ensemble.set_pose(given)

    def _remember(self, command: SetPose | Relocalize, problem: str) -> None:
        known = self.problems | {command.command_id: problem}
        self.problems = dict(list(known.items())[-KEPT_COMMANDS:])


def _held(
    command: SetPose | Relocalize, odometry: Trajectory, regions: str
) -> tuple[Commanded, str]:
    """Return the command with the odometry of its time, and the reason to refuse it or ""."""
    if isinstance(command, Relocalize):
        return Commanded(command), _region_problem(command.region, parsed_regions(regions))
    oldest_ns, newest_ns = odometry.oldest_ns, odometry.newest_ns
    if oldest_ns is None or newest_ns is None:
        return Commanded(command), ""
    stamp_ns = newest_ns if command.stamp_ns is None else min(command.stamp_ns, newest_ns)
    odom_from_robot = odometry.pose_at(stamp_ns)
    if odom_from_robot is None:
        ago_s = (oldest_ns - stamp_ns) / 1e9
        problem = f"the pose is of {ago_s:.1f} s before the oldest odometry that is known; "
        if ago_s < 0.0:
            problem = "the robot moved then without odometry; "
        return Commanded(command), problem + "give a newer one, or one without a stamp"
    return Commanded(command, stamp_ns, odom_from_robot), ""


def _can_be_judged(command: SetPose | Relocalize, ground: FreeGround | None) -> bool:
    return ground is not None or isinstance(command, Relocalize)


def _ground_problem(command: SetPose | Relocalize, ground: FreeGround | None) -> str:
    if ground is None or isinstance(command, Relocalize):
        return ""
    return ground.problem_of(command.map_from_robot, _covariance(command)) or ""


def _covariance(given: SetPose) -> Covariance:
    return given.covariance or diagonal(given.position_sigma_m, given.heading_sigma_rad)


def _region_problem(region: str, known: Mapping[str, object]) -> str:
    if not region or region in known:
        return ""
    names = ", ".join(known) or "none"
    return f"unknown region {printable(region)!r}; search.regions names {names}"


def _at_step(
    commanded: Commanded, given: SetPose, applied: Scan, motion: MotionSettings
) -> tuple[PoseTuple, Covariance]:
    """Carry a given pose by odometry to the step after which it is tracked.

    The motion from the pose to that step makes the pose less certain. A pose given after the step
    is carried back without noise, because the next step adds that noise.
    """
    covariance = _covariance(given)
    if commanded.odom_from_robot is None:
        return given.map_from_robot, covariance
    forth = commanded.stamp_ns < applied.stamp_ns
    return carried(
        given.map_from_robot,
        covariance,
        commanded.odom_from_robot,
        applied.odom_from_robot,
        motion if forth else None,
    )
