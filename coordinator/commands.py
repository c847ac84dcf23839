"""What a person may command: where the robot is, or to search everywhere."""

from coordinator.belief.given_places import candidate, diagonal
from coordinator.state import CoordinatorState
from particle_filter.random_streams import Purpose
from protocol.answers import Relocalize, SetPose
from protocol.steps import Scan

KEPT_COMMANDS = 100
"""A command that is asked once more is answered as before, if it is one of the last."""
TOO_EARLY = "no scan has arrived yet; start the robot or the recording first"


def carry_out(command: SetPose | Relocalize, state: CoordinatorState) -> bool:
    """Do what is commanded, at the time of the last applied scan, and remember that it was.

    Returns:
        Whether it was done; if not, the state say why.
    """
    scan = state.applied_scan
    if scan is not None:
        _obey(command, state, scan)
    state.commands_done[command.command_id] = "" if scan is not None else TOO_EARLY
    while len(state.commands_done) > KEPT_COMMANDS:
        del state.commands_done[next(iter(state.commands_done))]
    return scan is not None


def _obey(command: SetPose | Relocalize, state: CoordinatorState, scan: Scan) -> None:
    if isinstance(command, Relocalize):
        state.follow(state.ensemble.relocalize(scan.step), scan)
        return
    state.set_poses += 1
    settings = state.ensemble.settings
    given = candidate(
        settings.belief.set_pose_probability,
        command.map_from_robot,
        diagonal(command.position_sigma_m, command.heading_sigma_rad),
        seed=settings.seed,
        purpose=Purpose.GIVEN_POSE,
        entity=state.set_poses,
        step=scan.step,
        odom_from_robot=scan.odom_from_robot,
    )
    state.follow(state.ensemble.set_pose(given), scan)
