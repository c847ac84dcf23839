import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from clustermcl.belief.cluster_set import ClusterSet
from clustermcl.belief.ledger import DIGITS, MOST, Ledger, log_odds
from clustermcl.belief.outcome import Outcome
from clustermcl.filter.settings import BeliefSettings, ClusterSettings
from clustermcl.jobs.in_process import outcomes
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from tests.soak.eight_rooms import eight_rooms
from tests.unit.coordinator.reports import place

KIDNAPPED_AT, STEPS = 20, 40
ROUNDED = 0.5 * 10.0**-DIGITS


@given(st.lists(st.floats(-200.0, 200.0), min_size=2, max_size=8))
def test_log_odds_compare_a_hypothesis_with_all_others(log_values: list[float]) -> None:
    naive = [
        value - np.logaddexp.reduce(log_values[:index] + log_values[index + 1 :])
        for index, value in enumerate(log_values)
    ]
    assert_allclose(log_odds(log_values), naive, rtol=1e-9, atol=1e-9)


def test_log_odds_of_what_is_certain_or_impossible_are_finite() -> None:
    assert log_odds([0.0, -math.inf, -math.inf]) == [MOST, -MOST, -MOST]


def odds_of(outcome: Outcome) -> dict[int, float]:
    """Return the log odds by cluster; those of elsewhere have the key -1."""
    off = outcome.off_map_probability
    logs = [place.log_probability for place in outcome.hypotheses]
    outside = [outcome.elsewhere_probability - off, off]
    values = [*logs, *(math.log(max(p, 1e-300)) for p in outside)]
    numbers = [*(place.cluster for place in outcome.hypotheses), -1]
    return dict(zip(numbers, log_odds(values), strict=False))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> list[Outcome]:
    """A robot among eight rooms, which is kidnapped: places are found, merge and end."""
    world, bridge = eight_rooms(), BridgeSettings(gate_distance_m=0.1)
    simulation = Simulation(world, 3)

    def scans() -> Iterator[Scan]:
        for scan, _ in simulated_steps(simulation, bridge):
            if scan.step == STEPS:
                return
            if scan.step == KIDNAPPED_AT:
                simulation.kidnap()
            yield scan

    settings = Settings(
        belief=BeliefSettings(max_clusters=12, particles=4_000),
        cluster=ClusterSettings(particles=500, min_particles=100),
    )
    model = sensor_model(world.map, settings.sensor, tmp_path_factory.mktemp("maps"))
    return [outcome for _, outcome in outcomes(scans(), model, settings)]


def test_the_causes_sum_to_the_change_of_the_log_odds(run: list[Outcome]) -> None:
    compared = new = 0
    for before, after in pairwise(run):
        was, is_now = odds_of(before), odds_of(after)
        for index, (number, odds) in enumerate(is_now.items()):
            changes = after.why.of(index)
            total = sum(changes.values())
            # Elsewhere is a difference of published probabilities, so it has fewer digits.
            tolerance = ROUNDED * max(len(changes), 1) + (1e-6 if number >= 0 else 1e-2)
            assert total == pytest.approx(odds - was.get(number, 0.0), abs=tolerance), changes
            compared, new = compared + 1, new + (number not in was)
    assert compared > 100
    assert new > 4, "no place was found after the kidnapping"


def test_the_causes_of_a_kidnapped_robots_doubt_are_named(run: list[Outcome]) -> None:
    causes = {cause for outcome in run for cause in outcome.why.changes}
    assert {"scan", "scan over the whole map", "found by the search"} <= causes
    of_elsewhere = [outcome.why.of(len(outcome.hypotheses)) for outcome in run[KIDNAPPED_AT:]]
    assert max(changes.get("scan over the whole map", 0.0) for changes in of_elsewhere) > 1.0


def test_facts_belong_to_their_clusters(run: list[Outcome]) -> None:
    for outcome in run[5:15]:
        fits = outcome.why.facts["fit"]
        assert len(fits) == len(outcome.hypotheses)
        assert max(fits) >= 0.0
    assert set(outcome.why.facts) == {"fit", "counted", "new pieces"}


def test_an_unknown_cause_is_no_cause() -> None:
    clusters = ClusterSet()
    ledger = Ledger(clusters)
    ledger.note("nothing")
    assert ledger.why(()).changes == {}


def test_facts_are_in_the_order_of_the_hypotheses_and_0_where_they_are_unknown() -> None:
    clusters, candidate = ClusterSet(), place(0.5, (0.0, 0.0, 0.0), 0)
    clusters.admit([(candidate, "restart"), (candidate, "restart")], 0)
    ledger = Ledger(clusters)
    ledger.note_facts(fit=np.array([-1.25, math.nan]), counted=np.array([2.0, 9e9]), new_pieces=2.5)
    clusters.admit([(candidate, "restart")], 0)
    facts = ledger.why((1, 2, 0)).facts
    assert facts == {
        "fit": (0.0, 0.0, -1.25), "counted": (MOST, 0.0, 2.0), "new pieces": (2.5,)
    }  # fmt: skip


def test_a_part_of_an_update_is_noted_with_the_odds_of_all_hypotheses() -> None:
    clusters, candidate = ClusterSet(), place(0.5, (0.0, 0.0, 0.0), 0)
    clusters.admit([(candidate, "restart"), (candidate, "restart")], 0)
    ledger, before = Ledger(clusters), log_odds(clusters.log_probabilities().tolist())
    logs = np.log([0.5 / 3, 1.0 / 3, 0.3, 0.2])
    ledger.note("scan", logs + 7.0)  # they need not be normalised
    after = log_odds(logs.tolist())
    changes = ledger.why((0, 1)).changes["scan"]
    assert changes == pytest.approx(np.subtract(after, before), abs=2.0 * ROUNDED)
