"""The experiments in simulated halls and offices: found, lost, found again."""

from evaluation.experiments.case import ALIKE_BASELINES, Case, OnceRight, Role, SimulatedRobot
from evaluation.experiments.figures import mean, rate
from evaluation.experiments.usual_figures import CONFIDENTLY_WRONG, RIGHT_FOR_GOOD, RMSE


def hall_cases() -> tuple[Case, ...]:
    """Halls of 450 m2."""
    hall = Case(
        name="hall",
        title="An unambiguous hall of 450 m2, started anywhere",
        robot=SimulatedRobot(world="hall"),
        updates=100,
        typical_updates=100,
        role="training",
        seeds=20,
        asked_seeds=40,
        update_ms=8.0,
        ordinary_update_ms=11.0,
        figures=(
            rate("right at update 50", "right_at_50", at_least=1, wanted=39 / 40),
            rate("right at update 100", "right_at_100", at_least=1, wanted=None),
            rate("never confidently wrong", "confidently_wrong_share", at_most=0.0),
            mean("updates to the first 5 right ones in a row", "right_within"),
            RMSE,
        ),
    )
    symmetric = Case(
        name="hall-symmetric",
        title="A point-symmetric hall of 450 m2, 3,000 updates",
        robot=SimulatedRobot(world="hall_symmetric"),
        updates=3000,
        typical_updates=3000,
        symmetry=2,
        role="training",
        seeds=6,
        asked_seeds=20,
        baselines=ALIKE_BASELINES,
        update_ms=7.5,
        ordinary_update_ms=10.0,
        figures=(
            rate("truth tracked on 99 % or more of the updates", "tracked_share", at_least=0.99),
            rate(
                "its mean probability is 0.4 to 0.6",
                "truth_probability",
                at_least=0.4,
                at_most=0.6,
            ),
            mean("share of the updates with both places tracked", "all_tracked_share"),
            mean("normalised entropy of the 2 probabilities", "entropy_mean"),
            mean("places found by the first search", "copies_found"),
        ),
    )
    return hall, symmetric


def office_case() -> Case:
    """An office of thousands of m2, in which a scan fits hundreds of places."""
    return Case(
        name="office",
        title="A repetitive office of 5,900 m2, started anywhere",
        robot=SimulatedRobot(world="office"),
        updates=205,
        typical_updates=205,
        role="training",
        seeds=12,
        asked_seeds=24,
        update_ms=46.0,
        ordinary_update_ms=25.0,
        figures=(
            rate(
                "right 5 times in a row, begun within 200 updates",
                "right_within",
                at_most=200,
                wanted=22 / 24,
            ),
            rate("right on the last 10 updates", "localized", at_least=1, wanted=None),
            *RIGHT_FOR_GOOD,
            mean(
                "share of the updates that were confidently wrong",
                "confidently_wrong_share",
                at_most=0.01,
            ),
            mean("updates to the first 5 right ones in a row", "right_within"),
            RMSE,
        ),
    )


def disturbed_cases() -> tuple[Case, ...]:
    """A robot that is lifted elsewhere, a map that is wrong, people in the way."""
    return (
        _kidnapped(
            "hall",
            "the hall",
            within=100,
            wanted=23 / 24,
            at_latest=100,
            costs=(9.0, 11.0),
            seeds=24,
        ),
        _kidnapped(
            "office",
            "the office",
            within=200,
            wanted=20 / 24,
            at_latest=250,
            costs=(54.0, 22.0),
            seeds=12,
        ),
        _outdated(
            "moved", "started where the furniture was moved: the map is wrong there", "training"
        ),
        _outdated(
            "last-year", "with a map of last year: a tenth of the walls was moved", "validation"
        ),
        Case(
            name="people",
            title="The hall, with people who cut 30 % of the beams short",
            robot=SimulatedRobot(world="hall", people=22),
            updates=300,
            typical_updates=300,
            role="training",
            seeds=10,
            asked_seeds=20,
            update_ms=40.0,
            ordinary_update_ms=16.0,
            figures=(
                rate(
                    "tracking kept: truth tracked on 99 % or more of the updates "
                    "from the first 5 right ones in a row on",
                    "kept_share",
                    at_least=0.99,
                ),
                rate("right on the last 10 updates", "localized", at_least=1, wanted=None),
                *RIGHT_FOR_GOOD,
                mean(
                    "share of all updates after the bootstrap with the truth tracked",
                    "tracked_share",
                ),
                mean("updates to the first 5 right ones in a row", "right_within"),
                mean("share of the beams cut short", "short_beam_share"),
                RMSE,
                CONFIDENTLY_WRONG,
            ),
        ),
    )


def _outdated(name: str, what: str, role: Role) -> Case:
    return Case(
        name=f"hall-{name}",
        title=f"The hall, {what}",
        robot=SimulatedRobot(world=f"hall_{name.replace('-', '_')}"),
        role=role,
        updates=105,
        typical_updates=105,
        seeds=20,
        update_ms=16.0,
        ordinary_update_ms=11.0,
        figures=(
            rate(
                "right 5 times in a row, begun within 100 updates",
                "right_within",
                at_most=100,
                wanted=18 / 20,
            ),
            mean("updates to the first 5 right ones in a row", "right_within"),
            RMSE,
            CONFIDENTLY_WRONG,
        ),
    )


def _kidnapped(
    world: str,
    where: str,
    *,
    within: int,
    wanted: float,
    at_latest: int,
    costs: tuple[float, float],
    seeds: int,
) -> Case:
    return Case(
        name=f"kidnap-{world}",
        title=f"Lifted to another place of {where} after 40 right updates in a row",
        robot=SimulatedRobot(world=world, kidnapping=OnceRight(at_latest)),
        updates=at_latest + within + 5,
        updates_after_event=within + 5,
        typical_updates=80 + within,
        role="training",
        seeds=seeds,
        asked_seeds=24,
        update_ms=costs[0],
        ordinary_update_ms=costs[1],
        figures=(
            rate(
                f"right 5 times in a row, begun within {within} updates of the kidnapping",
                "right_after_kidnap",
                at_most=within,
                wanted=wanted,
            ),
            rate(
                "lost or ambiguous within 10 updates of it",
                "alarm_after_kidnap",
                at_most=10,
            ),
            mean("updates from the kidnapping to that", "alarm_after_kidnap"),
            mean("updates from the kidnapping to the first 5 right ones", "right_after_kidnap"),
            rate(
                "40 right updates in a row before it",
                "right_before_kidnap",
                at_least=1,
                wanted=None,
            ),
            CONFIDENTLY_WRONG,
        ),
    )
