"""All experiments with simulated robots, in the order of the report."""

from evaluation.experiments.building_cases import disturbed_cases, hall_cases, office_case
from evaluation.experiments.case import Case
from evaluation.experiments.symmetric_cases import feature_cases, symmetric_cases


def simulated_cases() -> tuple[Case, ...]:
    """They need no file."""
    return (*symmetric_cases(), *feature_cases(), *hall_cases(), office_case(), *disturbed_cases())
