import math
import re
from pathlib import Path

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief.bayes_update import weigh
from clustermcl.belief.cluster_set import ESTABLISHED, LEAST_LOG, Candidate, ClusterSet, Given
from clustermcl.belief.familiarity import Familiarity
from clustermcl.filter.laser.evidence_model import LARGE_FALL, scan_exponent, through_beam_loss
from clustermcl.filter.settings import FilterSettings, SensorSettings
from clustermcl.protocol.job_events import Ended
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import TrackReport
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from tests.unit.coordinator.reports import elsewhere, literal_bayes, place, tracked

NORTH, SOUTH, EAST = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (5.0, 0.0, 0.0)
PLACES: tuple[PoseTuple, ...] = (NORTH, SOUTH, EAST)


def first(*shares: float, **belief: object) -> ClusterSet:
    """Clusters with these probabilities; the rest is elsewhere."""
    rules = literal_bayes(**{"kidnapping_probability": 0.01, **belief})
    made = ClusterSet(FilterSettings(belief=rules))
    made.take_from_elsewhere(min(math.fsum(shares), 1.0))
    made.admit([(place(s, PLACES[i % 3], 0), "first search") for i, s in enumerate(shares)], 0)
    return made


def reports_of(*likelihoods: float) -> dict[str, TrackReport]:
    return {
        f"c{i}": tracked(f"c{i}", 1, value, PLACES[i % 3]) for i, value in enumerate(likelihoods)
    }


def probabilities(made: ClusterSet) -> list[float]:
    return [*(cluster.probability for cluster in made.all()), made.elsewhere]


def test_with_the_settings_that_the_page_names_the_update_is_the_papers() -> None:
    page = Path("docs/belief.md").read_text()
    named = re.search(r"With (`piece_evidence[^()]*) \(all of `belief`\) the update is", page)
    assert named
    settings = Settings()
    for name, value in re.findall(r"`(\w+) = (\S+)`", named[1]):
        settings = with_setting(settings, f"belief.{name}", float(value), "the page")
    rules = replace(settings.belief, least_probability=0.0)
    made = ClusterSet(FilterSettings(belief=rules))
    made.take_from_elsewhere(1.0)
    made.admit([(place(s, PLACES[i], 0), "first search") for i, s in enumerate((0.6, 0.4))], 0)
    weigh(made, reports_of(0.01, 0.4))
    assert probabilities(made) == pytest.approx([0.006 / 0.166, 0.16 / 0.166, 0.0])


def test_before_the_first_place_the_robot_is_elsewhere() -> None:
    made = ClusterSet(FilterSettings(belief=literal_bayes()))
    assert probabilities(made) == [1.0]
    weigh(made, {}, elsewhere(1, -3.0))
    assert probabilities(made) == [1.0]


def test_elsewhere_takes_part_in_bayes_rule_after_a_kidnapping_was_possible() -> None:
    made = first(0.6, 0.3)
    weigh(made, reports_of(0.2, 0.1), elsewhere(1, math.log(0.05)))
    after = [0.6 * 0.99 * 0.2, 0.3 * 0.99 * 0.1, (0.1 * 0.99 + 0.01) * 0.05]
    assert probabilities(made) == pytest.approx([p / math.fsum(after) for p in after])


def test_the_belief_of_a_standing_robot_does_not_change() -> None:
    made = first(0.6, 0.3, piece_evidence=0.7)
    for _ in range(1000):
        weigh(made, reports_of(0.9, 0.1), elsewhere(1, 5.0), beams=np.zeros(0), news=0.0)
    assert probabilities(made) == pytest.approx([0.6, 0.3, 0.1])


def test_the_probability_of_a_kidnapping_scales_with_the_new_share_of_a_view() -> None:
    made = first(0.6, 0.4)
    half = 0.5
    weigh(made, reports_of(0.1, 0.1), elsewhere(1, math.log(0.1)), news=half)
    there = 1.0 - 0.005
    assert probabilities(made) == pytest.approx([there * 0.6, there * 0.4, 0.005])


def test_elsewhere_keeps_its_probability_if_it_is_not_weighed() -> None:
    made = first(0.6, 0.3)
    weigh(made, reports_of(0.2, 0.1))
    assert made.elsewhere == pytest.approx(0.1 * 0.99 + 0.01)


def test_a_report_of_an_ended_cluster_is_ignored() -> None:
    """Its worker may not have received the order yet, or there was no coordinator to send it."""
    both, one = (first(0.6, 0.3) for _ in range(2))
    weigh(both, reports_of(0.2, 0.1, 0.9), elsewhere(1, -3.0))
    weigh(one, reports_of(0.2, 0.1), elsewhere(1, -3.0))
    assert probabilities(both) == probabilities(one)


def test_elsewhere_is_impossible_if_the_robot_is_never_kidnapped() -> None:
    made = first(0.6, 0.3, kidnapping_probability=0.0)
    assert probabilities(made) == pytest.approx([2 / 3, 1 / 3, 0.0])
    weigh(made, reports_of(0.1, 0.2))
    assert probabilities(made) == pytest.approx([0.5, 0.5, 0.0])
    made.admit([(place(1.0, EAST, 1), "given")], 1)
    assert made.elsewhere == 0.0
    made.clear("forgotten")
    assert probabilities(made) == [1.0], "nothing is known any more"
    made.admit([(place(19.0, EAST, 1), "given")], 1)
    assert probabilities(made) == [1.0, 0.0]


FITS = {"c0": (1.0, 0.5, 0.0, -1.0), "c1": (0.5, 0.5, 1.0, 0.0)}
NEW = np.array([0.5, 0.25, 0.0, 0.25])
"""What is new of four beams."""


def with_fits(
    fits: dict[str, tuple[float, ...]], likelihood: float = 1.0
) -> dict[str, TrackReport]:
    return {
        job: tracked(job, 1, likelihood, PLACES[i], fits=each)
        for i, (job, each) in enumerate(fits.items())
    }


def half_fit(made: ClusterSet) -> float:
    """What a beam explains whose log-likelihood is half of that of one on an obstacle."""
    return math.expm1(made.sharpness * 64 / 127) / math.expm1(made.sharpness)


def test_a_place_gains_by_the_new_beams_that_fit_there() -> None:
    """Not by those that have counted, and beams through walls are only misses."""
    made = first(0.6, 0.4, piece_evidence=2.0)
    half = half_fit(made)
    unit = made.learned.evidence_among(made.best.familiarity, made.changed)
    weigh(made, with_fits(FITS), beams=NEW)
    one, other, _ = probabilities(made)
    gained = unit * (0.5 * 1.0 + 0.25 * half - 0.5 * half - 0.25 * half)
    assert math.log(one / other) == pytest.approx(math.log(1.5) + gained, abs=0.01)


def test_how_well_the_map_explains_new_beams_is_learned() -> None:
    made = first(0.75, 0.25, piece_evidence=2.0, kidnapping_probability=0.0)
    expected, others = Familiarity(), made.learned.others
    equal = {"c0": (1.0, 0.5, 0.0, -1.0), "c1": (1.0, 0.5, 1.0, 0.0)}
    explained = 0.5 + 0.25 * half_fit(made)
    weigh(made, with_fits(equal), beams=NEW)
    learned = [
        made.learned.probable,
        *(cluster.familiarity for cluster in made.all()),
        made.learned.others,
    ]
    expected = [*[expected.after(1.0, explained)] * 3, others.after(0.25, 0.25 * explained)]
    for one, other in zip(learned, expected, strict=True):
        assert one.share == pytest.approx(other.share)
        assert one.new == pytest.approx(other.new)


def test_a_wrong_place_does_not_hide_how_much_the_right_one_explains() -> None:
    """It is sure at first, and explains little: the other is the best, however improbable."""
    made = first(0.99, 0.01, piece_evidence=0.7, kidnapping_probability=1e-9)
    steps = 0
    while probabilities(made)[1] < 0.9:
        steps += 1
        assert steps < 60
        fits = {"c0": (0.6,) * 4, "c1": (0.95,) * 4}
        weigh(made, with_fits(fits), beams=NEW)
    assert made.best.cluster == 1
    assert made.learned.evidence_among(made.best.familiarity, made.changed) > 0.5


@pytest.mark.parametrize(
    ("fits", "beams"), [(FITS, None), (FITS, np.full(3, 0.5)), ({**FITS, "c1": (1.0,)}, NEW)]
)
def test_a_scan_whose_beams_are_unknown_separates_no_places(
    fits: dict[str, tuple[float, ...]], beams: NDArray[np.float64] | None
) -> None:
    """The report of elsewhere was lost or is of another scan, or a place has other beams."""
    made = first(0.6, 0.4, piece_evidence=2.0, kidnapping_probability=1e-9)
    weigh(made, with_fits(fits), elsewhere(1, -1.0), beams=beams)
    assert probabilities(made) == pytest.approx([0.6, 0.4, 0.0], abs=1e-6)


def test_an_improbable_place_does_not_change_the_ratio_of_two_places() -> None:
    """However well the third one fits."""
    fits = {**FITS, "c2": (1.0,) * 4}
    ratios = []
    for shares in ((0.6, 0.4), (0.594, 0.396, 0.01)):
        made = first(*shares, piece_evidence=2.0)
        weigh(made, with_fits(fits), beams=NEW)
        ratios.append(made.all()[0].log_probability - made.all()[1].log_probability)
    assert ratios[0] == pytest.approx(ratios[1], abs=1e-9)


def test_elsewhere_learns_from_a_scan_as_far_as_the_robot_has_moved() -> None:
    made = first(0.8, kidnapping_probability=1e-9)
    weigh(made, reports_of(0.5), elsewhere(1, math.log(0.1)), news=0.5)
    assert math.log(made.elsewhere / probabilities(made)[0]) == pytest.approx(
        math.log(0.2 / 0.8) + 0.5 * math.log(0.2)
    )


@pytest.mark.parametrize(("fits", "gain"), [((1.0,) * 4, 1.0), ((-1.0,) * 4, 10.0)])
def test_a_better_fit_elsewhere_counts_only_if_beams_pass_through_walls_here(
    fits: tuple[float, ...], gain: float
) -> None:
    """People stand before the laser, and the other beams fit."""
    made = first(0.9, piece_evidence=2.0, kidnapping_probability=1e-9)
    weigh(made, with_fits({"c0": fits}, 0.5), elsewhere(1, math.log(5.0)), beams=NEW)
    assert made.elsewhere / probabilities(made)[0] == pytest.approx(gain / 9.0)


def test_beams_through_walls_lower_the_fit_by_what_they_are_less_probable() -> None:
    made, sensor = first(1.0, off_map_probability=0.05), SensorSettings()
    weigh(made, with_fits({"c0": (1.0,) * 50 + (-1.0,) * 10}), beams=np.zeros(60))
    lost = 10 * scan_exponent(60, sensor) * through_beam_loss(sensor)
    assert lost > 1.0
    assert made.fit.mean == pytest.approx(-lost)


@pytest.mark.parametrize(("usual", "is_alarmed"), [(0, True), (30, False)])
def test_beams_cut_short_raise_elsewhere_only_where_no_people_were_seen_before(
    usual: int, *, is_alarmed: bool
) -> None:
    """A kidnapped robot and one in a crowd see the same: short beams, and a few through walls."""
    made = first(1.0, kidnapping_probability=0.001, off_map_probability=0.05, piece_evidence=0.7)
    at_people = [0.0] * usual + [1.0] * (60 - usual)
    lifted = [1.0] * 6 + [-1.0] * 4 + [0.0] * 50
    for fits, likelihood in [(at_people, 1.0)] * 40 + [(lifted, math.exp(-26.0))] * 2:
        report = tracked("c0", 1, likelihood, NORTH, fits=fits)
        weigh(made, {"c0": report}, elsewhere(1, -17.0), beams=np.zeros(60), news=0.9)
    assert (made.elsewhere > 0.5) is is_alarmed


def test_candidates_take_the_evidence_they_explain_from_elsewhere() -> None:
    """Elsewhere had 0.5; the search explains 0.8 of it, half of which the candidate has."""
    made = first(0.5)
    made.take_from_elsewhere(0.8)
    made.admit([(place(0.2, SOUTH, 1), "restart")], 1)
    assert probabilities(made) == pytest.approx([0.5 / 0.8, 0.2 / 0.8, 0.1 / 0.8])
    made.take_from_elsewhere(1.0)
    made.admit([], 1)
    assert probabilities(made) == pytest.approx([5 / 7, 2 / 7, 0.0])
    weigh(made, reports_of(0.1, 0.1), elsewhere(1, math.nan))
    assert made.elsewhere == pytest.approx(0.01), "until the robot may have been lifted"


def test_weights_of_candidates_are_relative_to_the_belief() -> None:
    made = first(0.5, 0.3, 0.2, max_clusters=3)
    assert made.room() == pytest.approx([0.2, 0.3, 0.5])
    admitted, _ = made.admit([(place(0.45, NORTH, 1), "restart")], 1)
    assert [c.probability for c in made.all()] == pytest.approx([0.4, 0.24, 0.36])
    assert admitted[0].born_step == 1
    assert made.room() == pytest.approx([0.24, 0.36, 0.4])


def test_the_event_of_a_replaced_cluster_names_its_successor() -> None:
    """Of three candidates the first takes the free place, the others the least probable ones'."""
    made = first(0.5, 0.2, 0.3, max_clusters=4)
    more: list[Candidate] = [(place(0.1, EAST, 0), "restart") for _ in range(3)]
    _, events = made.admit(more, 1)
    assert [event for event in events if isinstance(event, Ended)] == [
        Ended("c1", "pushed out", ("c4",), pytest.approx(0.2)),
        Ended("c2", "pushed out", ("c5",), pytest.approx(0.3)),
    ]


def test_a_place_whose_probability_underflows_keeps_the_least_probability() -> None:
    made = first(1.0, 0.0)
    first_one, second = made.by_probability()
    assert (first_one.cluster, second.cluster) == (0, 1)
    assert first_one.log_probability == pytest.approx(0.0)
    assert second.log_probability == LEAST_LOG


def test_the_probability_of_a_dropped_cluster_goes_to_elsewhere() -> None:
    made = first(0.5, 0.3, 0.1, least_probability=0.2)
    (ended,) = made.drop_improbable()
    assert ended == Ended("c2", "improbable", (), pytest.approx(0.1))
    assert probabilities(made) == pytest.approx([0.5, 0.3, 0.2])
    never = first(0.6, 0.3, 0.1, least_probability=0.2, kidnapping_probability=0.0)
    never.drop_improbable()
    assert probabilities(never) == pytest.approx([2 / 3, 1 / 3, 0.0])


def test_the_best_stays_when_improbable_ones_are_dropped() -> None:
    made = first(0.15, 0.1, 0.05, least_probability=0.2)
    assert [ended.job_id for ended in made.drop_improbable()] == ["c1", "c2"]
    assert made.drop_improbable() == []
    assert math.fsum(probabilities(made)) == pytest.approx(1.0)


SMALL = st.floats(1e-6, 1.0)
DEEDS = st.lists(
    st.one_of(
        st.tuples(st.just("weigh"), st.lists(SMALL, min_size=4, max_size=4), SMALL),
        st.tuples(st.just("admit"), st.lists(SMALL, max_size=3), SMALL),
        st.tuples(st.just("drop"), st.none(), st.none()),
        st.tuples(st.just("merge"), st.none(), st.none()),
        st.tuples(st.just("clear"), st.none(), st.none()),
    ),
    max_size=12,
)


@hypothesis.given(DEEDS, st.sampled_from([0.0, 1e-3, 0.2]))
def test_the_places_and_elsewhere_sum_to_one_whatever_happens(
    deeds: list[tuple[str, tuple[float, ...], float]], hazard: float
) -> None:
    made = first(0.5, 0.3, kidnapping_probability=hazard, least_probability=0.05)
    for step, (deed, values, value) in enumerate(deeds):
        match deed:
            case "weigh":
                values_by_job = dict(zip(made.job_ids, values, strict=False))
                reports = {job: tracked(job, step, v, NORTH) for job, v in values_by_job.items()}
                weigh(made, reports, elsewhere(step, math.log(value)) if hazard > 0.0 else None)
            case "admit":
                made.take_from_elsewhere(value)
                made.admit([(place(v, SOUTH, step), "restart") for v in values], step)
            case "drop":
                made.drop_improbable()
            case "merge":
                made.merge_overlaps()
            case "clear":
                made.clear("forgotten")
        assert math.fsum(probabilities(made)) == pytest.approx(1.0, abs=1e-9)
        assert all(math.isfinite(cluster.log_probability) for cluster in made.all())
        if hazard == 0.0 and len(made):
            assert made.elsewhere == 0.0


def test_two_clusters_at_one_place_merge_with_their_joint_probability() -> None:
    made = first(0.3, 0.5)
    made.clusters[1] = replace(made.clusters[1], pose=(0.1, 5.0, 0.0))
    assert made.merge_overlaps() == [Ended("c0", "merged", ("c1",), pytest.approx(0.3))]
    assert probabilities(made) == pytest.approx([0.8, 0.2])


def test_beams_against_a_given_place_add_up_to_doubt_until_it_is_established() -> None:
    for_it = Given().after(-5.0, 1.0)
    assert for_it == Given(1.0, 0.0), "what speaks for it is no credit"
    doubted = for_it.after(LARGE_FALL, 0.5)
    assert doubted == Given(1.5, LARGE_FALL)
    assert not doubted.is_doubted
    assert doubted.after(0.01, 0.0).is_doubted
    assert Given(ESTABLISHED - 0.1).after(9.0, 1.0).is_doubted
    assert Given(ESTABLISHED, 9.0).after(9.0, 1.0) == Given(ESTABLISHED + 1.0, 0.0)


def test_a_given_place_is_tracked_alone_once_it_is_established_and_more_likely_than_not() -> None:
    made = first(0.6, 0.3)
    made.given = Given(ESTABLISHED - 0.1, searched=True)
    assert made.drop_improbable() == []
    made.given = made.given.after(9.0, 0.1)
    assert not made.given.is_doubted, "a search has answered the doubt"
    assert [ended.job_id for ended in made.drop_improbable()] == ["c1"]
    assert probabilities(made) == pytest.approx([0.6, 0.4])
    later = first(0.4, 0.5)
    later.given = made.given
    assert later.drop_improbable() == [], "what holds was not given"
