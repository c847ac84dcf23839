import pytest
from msgspec.structs import replace

from clustermcl.coordinator.report_checks import checked
from clustermcl.filter.settings import (
    BeliefSettings,
    ClusterSettings,
    FilterSettings,
    SearchSettings,
)
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.work import Report
from tests.unit.coordinator import reports

HERE = (0.0, 0.0, 0.0)
SETTINGS = FilterSettings(
    cluster=ClusterSettings(particles=2),
    search=SearchSettings(places=3, hand_over_particles=4),
    belief=BeliefSettings(max_clusters=1),
)
"""Clouds of two particles, as the tests' are; three places of 4, 1 and 1 particles."""


def test_a_snapshot_with_more_particles_than_a_cluster_is_left_out() -> None:
    report = reports.tracked("c0", 1, 1.0, HERE, snapshot=reports.cloud_at(HERE, 1))
    assert checked(report, SETTINGS) is report
    smaller = replace(SETTINGS, cluster=ClusterSettings(particles=1))
    assert checked(report, smaller) == replace(report, snapshot=None)


def found(*counts: int) -> Report:
    report = reports.searched("s0.0", 1, {})
    return replace(report, places=reports.found_places([(0.1, HERE)] * len(counts), max(counts)))


@pytest.mark.parametrize(
    "report", [found(1, 1, 1, 1), found(4, 4)], ids=["places", "particles of places"]
)
def test_a_report_with_more_places_than_allowed_is_refused(report: Report) -> None:
    with pytest.raises(MalformedMessageError, match="by the settings") as caught:
        checked(report, SETTINGS)
    assert caught.value.cause.endswith("more than its job allows")


@pytest.mark.parametrize(
    "report", [found(2, 2, 2), reports.elsewhere(1, 0.0)], ids=["places", "elsewhere"]
)
def test_a_report_with_the_largest_allowed_number_of_places_is_accepted(report: Report) -> None:
    assert checked(report, SETTINGS) is report
