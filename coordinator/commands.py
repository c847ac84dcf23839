"""What a person may command: where the robot is, or to search everywhere."""

from collections.abc import Mapping

import msgspec
from msgspec.structs import replace

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.given_places import candidate, diagonal
from coordinator.belief.outcome import Outcome
from coordinator.dead_reckoning import carried
from coordinator.free_ground import FreeGround
from particle_filter.random_streams import Purpose
from particle_filter.regions import parsed_regions
from particle_filter.settings import MotionSettings
from particle_filter.trajectory import Trajectory
from protocol.answers import Relocalize, SetPose
from protocol.errors import printable
from protocol.message import Covariance, PoseTuple
from protocol.steps import Scan

KEPT_COMMANDS = 100
"""A command that is asked once more is answered as before, if it is one of the last."""
HANDED_ON_COMMANDS = 20


class Commanded(msgspec.Struct, frozen=True):
    """A command, and where odometry was when it held."""

    command: SetPose | Relocalize
    stamp_ns: int = 0
    odom_from_robot: PoseTuple | None = None
    """None: there was none yet; the robot stood until the first."""
    during_search: bool = False
    """The first search had begun already."""


class CommandsState(msgspec.Struct, frozen=True):
    """What has been commanded, as it is handed on."""

    problems: dict[str, str]
    """The last commands' ids to the reason why each was refused; empty for one that was done."""
    set_poses: int
    """How many poses have been given; their random streams are numbered by it."""
    waiting: Commanded | None = None
    """Came before the first step, or before the map, and is carried out after both."""


class Commands:
    """Carries out each command once, however often it is asked."""

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        self._set_poses = 0
        self._waiting: Commanded | None = None

    def problem(self, command_id: str) -> str | None:
        """Why a command was refused, empty if it was done; None for one that is new."""
        return self._problems.get(command_id)

    @property
    def forgets(self) -> bool:
        """Whether the first search is to begin without anything that was known before."""
        return self._waiting is not None and isinstance(self._waiting.command, Relocalize)

    def carry_out(
        self,
        command: SetPose | Relocalize,
        ensemble: Ensemble,
        applied: Scan | None,
        odometry: Trajectory,
        ground: FreeGround | None,
    ) -> Outcome | None:
        """Do what is commanded, as of the last applied scan.

        What comes before the first scan is remembered until `carry_out_waiting`, and so is a pose
        that comes before the map; of several, the last counts.

        Args:
            command: it has an id that is new.
            ensemble: is told.
            applied: the scan of the last step; None before the first.
            odometry: tells how the robot moved since a pose was true.
            ground: where a robot can be; None: the map has not arrived yet.

        Returns:
            None where nothing is done now: it waits, or is refused.
        """
        commanded, problem = _held(command, odometry, ensemble.settings.search.regions)
        problem = problem or _ground_problem(command, ground)
        self._problems[command.command_id] = problem
        while len(self._problems) > KEPT_COMMANDS:
            del self._problems[next(iter(self._problems))]
        if problem:
            return None
        if applied is None or not _can_be_judged(command, ground):
            self._waiting = replace(commanded, during_search=ensemble.searches > 0)
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
        waiting = self._waiting
        if waiting is None or not _can_be_judged(waiting.command, ground):
            return None
        self._waiting = None
        if problem := _ground_problem(waiting.command, ground):
            self._problems[waiting.command.command_id] = problem
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
        self._set_poses += 1
        settings = ensemble.settings
        mean, covariance = _at_step(commanded, commanded.command, applied, settings.motion)
        given = candidate(
            settings.belief.set_pose_probability,
            mean,
            covariance,
            seed=settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self._set_poses,
            step=applied.step,
            odom_from_robot=applied.odom_from_robot,
        )
        return ensemble.set_pose(given)

    def state(self) -> CommandsState:
        """The last commands, to be handed on."""
        recent = dict(list(self._problems.items())[-HANDED_ON_COMMANDS:])
        return CommandsState(recent, self._set_poses, self._waiting)

    def restore(self, state: CommandsState) -> None:
        """Know what another coordinator was commanded."""
        self._problems |= state.problems
        self._set_poses = state.set_poses
        self._waiting = state.waiting or self._waiting


def _held(
    command: SetPose | Relocalize, odometry: Trajectory, regions: str
) -> tuple[Commanded, str]:
    """The command with the odometry of its time, and why it cannot be carried out, if so."""
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
    """A given pose, carried by odometry to the step after which it is tracked.

    The motion there makes it less certain. What is told of now, after the step, is carried back
    as it is: it gets its noise on the way forth.
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
