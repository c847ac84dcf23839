"""What a person may command: where the robot is, or to search everywhere."""

import msgspec

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.given_places import candidate, diagonal
from coordinator.belief.outcome import Outcome
from particle_filter.random_streams import Purpose
from protocol.answers import Relocalize, SetPose
from protocol.steps import Scan

KEPT_COMMANDS = 100
"""A command that is asked once more is answered as before, if it is one of the last."""
HANDED_ON_COMMANDS = 20
TOO_EARLY = "no scan has arrived yet; start the robot or the recording first"


class CommandsState(msgspec.Struct, frozen=True):
    """What has been commanded, as it is handed on."""

    problems: dict[str, str]
    """The last commands' ids to the reason why each was refused; empty for one that was done."""
    set_poses: int
    """How many poses have been given; their random streams are numbered by it."""


class Commands:
    """Carries out each command once, however often it is asked."""

    def __init__(self) -> None:
        self._problems: dict[str, str] = {}
        self._set_poses = 0

    def problem(self, command_id: str) -> str | None:
        """Why a command was refused, empty if it was done; None for one that is new."""
        return self._problems.get(command_id)

    def carry_out(
        self, command: SetPose | Relocalize, ensemble: Ensemble, applied: Scan | None
    ) -> Outcome | None:
        """Do what is commanded, as of the last applied scan; None if it is refused."""
        outcome = self._outcome(command, ensemble, applied) if applied is not None else None
        self._problems[command.command_id] = TOO_EARLY if outcome is None else ""
        while len(self._problems) > KEPT_COMMANDS:
            del self._problems[next(iter(self._problems))]
        return outcome

    def _outcome(self, command: SetPose | Relocalize, ensemble: Ensemble, applied: Scan) -> Outcome:
        if isinstance(command, Relocalize):
            return ensemble.relocalize(applied.step, near=command.near)
        self._set_poses += 1
        settings = ensemble.settings
        given = candidate(
            settings.belief.set_pose_probability,
            command.map_from_robot,
            diagonal(command.position_sigma_m, command.heading_sigma_rad),
            seed=settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self._set_poses,
            step=applied.step,
            odom_from_robot=applied.odom_from_robot,
        )
        return ensemble.set_pose(given)

    def state(self) -> CommandsState:
        """The last commands, to be handed on."""
        return CommandsState(
            dict(list(self._problems.items())[-HANDED_ON_COMMANDS:]), self._set_poses
        )

    def restore(self, state: CommandsState) -> None:
        """Know what another coordinator was commanded."""
        self._problems |= state.problems
        self._set_poses = state.set_poses
