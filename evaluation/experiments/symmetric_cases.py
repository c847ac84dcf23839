"""The experiments in symmetric worlds: places that nobody can tell apart, or only late."""

import msgspec

from evaluation.experiments.case import ALIKE_BASELINES, Case, SimulatedRobot
from evaluation.experiments.figures import Figure, mean, rate
from evaluation.experiments.usual_figures import CONFIDENTLY_WRONG, RIGHT_FOR_GOOD, RMSE

_NO_VISIBILITY = "sensor.visibility_particles=0"
_NO_TRANSITION = "belief.transition_probability=0"


def symmetric_cases() -> tuple[Case, ...]:
    """Worlds that are symmetric to the last cell."""
    cross = Case(
        name="cross",
        title="Four places that nobody can tell apart, 3,000 updates",
        robot=SimulatedRobot(world="cross"),
        updates=3000,
        typical_updates=3000,
        symmetry=4,
        role="training",
        seeds=6,
        asked_seeds=20,
        baselines=ALIKE_BASELINES,
        update_ms=8.0,
        ordinary_update_ms=11.0,
        figures=(
            *_all_tracked(4),
            mean("normalised entropy of the 4 probabilities", "entropy_mean", at_least=0.95),
            rate("it is never under 0.5", "entropy_min", at_least=0.5),
            rate("the most probable place changes 3 times or more", "leader_changes", at_least=3),
            mean("changes of the most probable place", "leader_changes"),
            mean("places found by the first search", "copies_found"),
        ),
    )
    rectangle = Case(
        name="rectangle",
        title="Two places that nobody can tell apart, 3,000 updates",
        robot=SimulatedRobot(world="rectangle"),
        updates=3000,
        typical_updates=3000,
        symmetry=2,
        role="training",
        seeds=6,
        asked_seeds=20,
        baselines=ALIKE_BASELINES,
        update_ms=5.5,
        ordinary_update_ms=12.0,
        figures=(
            *_all_tracked(2),
            mean("normalised entropy of the 2 probabilities", "entropy_mean", at_least=0.95),
            mean("its lowest value in a run", "entropy_min"),
            mean("places found by the first search", "copies_found"),
        ),
    )
    return cross, rectangle, _without_transition(cross, 4), _without_transition(rectangle, 2)


def _all_tracked(places: int) -> tuple[Figure, ...]:
    text = f"all {places} places tracked on 99 % or more of the updates after the bootstrap"
    return (
        rate(text, "all_tracked_share", at_least=0.99),
        mean("share of the updates on which they are", "all_tracked_share"),
    )


def _without_transition(case: Case, places: int) -> Case:
    """The same by eq. 14 to the letter: no robot ever changes from one cluster to another."""
    return Case(
        name=f"{case.name}-no-transition",
        title=f"{case.title}, without any transition probability (eq. 14 to the letter)",
        robot=case.robot,
        updates=case.updates,
        typical_updates=case.typical_updates,
        symmetry=case.symmetry,
        seeds=4,
        asked_seeds=case.asked_seeds,
        baselines=(),
        update_ms=case.update_ms,
        ordinary_update_ms=case.ordinary_update_ms,
        role=case.role,
        settings=(_NO_TRANSITION,),
        figures=(
            *_all_tracked(places),
            mean(f"normalised entropy of the {places} probabilities", "entropy_mean"),
            mean("its lowest value in a run", "entropy_min"),
        ),
    )


def feature_cases() -> tuple[Case, ...]:
    """Worlds in which one thing, seen late, tells the symmetric places apart."""
    gates = _gates()
    return gates, _without_visibility(gates), _cross_with_a_feature()


def _without_visibility(case: Case) -> Case:
    """The other half of the 2 x 2 of clusters and visibility: one cloud or many, without it.

    Nobody can ask to be right without seeing what tells.
    """
    figures = [
        msgspec.structs.replace(each, wanted_share=None) if each.measure == "localized" else each
        for each in case.figures
    ]
    return msgspec.structs.replace(
        case,
        name=f"{case.name}-no-visibility",
        title=f"{case.title}; nobody looks for hidden ends of beams",
        seeds=10,
        baselines=("mcl",),
        settings=(_NO_VISIBILITY,),
        figures=tuple(figures),
    )


def _gates() -> Case:
    return Case(
        name="gates",
        role="training",
        title="A two-fold symmetric room; one missing cabinet, seen in the last segment, tells",
        robot=SimulatedRobot(world="gates"),
        updates=400,
        updates_after_event=40,
        typical_updates=325,
        symmetry=2,
        has_feature=True,
        seeds=16,
        asked_seeds=40,
        baselines=("paper-letter", "mcl", "mcl-visibility", "amcl-visibility"),
        update_ms=7.0,
        ordinary_update_ms=12.0,
        figures=(
            rate(
                "both places tracked on 99 % or more of the updates until it is seen",
                "all_tracked_until_seen_share",
                at_least=0.99,
            ),
            rate("right on the last 10 of the 40 updates after it", "localized", at_least=1),
            *RIGHT_FOR_GOOD,
            mean("updates from seeing it to being right for good", "settled_after_seen"),
            RMSE,
            CONFIDENTLY_WRONG,
        ),
    )


def _cross_with_a_feature() -> Case:
    return Case(
        name="cross-feature",
        title="The cross with one cabinet at the end of one arm",
        robot=SimulatedRobot(world="cross_feature"),
        updates=400,
        updates_after_event=40,
        typical_updates=190,
        symmetry=4,
        has_feature=True,
        seeds=20,
        update_ms=7.0,
        ordinary_update_ms=10.0,
        figures=(
            rate(
                "right for good within 15 updates of seeing it",
                "settled_after_seen",
                at_most=15,
            ),
            mean("updates from seeing it to being right for good", "settled_after_seen"),
            mean(
                "share of the updates before it with all 4 places tracked",
                "all_tracked_until_seen_share",
            ),
            RMSE,
            CONFIDENTLY_WRONG,
        ),
    )
