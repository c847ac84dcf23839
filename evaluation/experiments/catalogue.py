"""All experiments with simulated robots, in the order of the report."""

import msgspec

from evaluation.experiments.building_cases import disturbed_cases, hall_cases, office_case
from evaluation.experiments.case import Case
from evaluation.experiments.symmetric_cases import feature_cases, symmetric_cases
from evaluation.experiments.usual_figures import SCORES


def simulated_cases() -> tuple[Case, ...]:
    """They need no file."""
    cases = (
        *symmetric_cases(),
        *feature_cases(),
        *hall_cases(),
        office_case(),
        *disturbed_cases(),
    )
    return tuple(msgspec.structs.replace(case, figures=(*case.figures, *SCORES)) for case in cases)
