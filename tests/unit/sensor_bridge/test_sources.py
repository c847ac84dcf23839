import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.observations.fixes import PoseFix, PositionFix
from clustermcl.filter.observations.observed import Observed
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.health import MAX_SOURCES
from clustermcl.protocol.message import Covariance
from clustermcl.protocol.steps import MAX_LANDMARKS, Landmark
from clustermcl.sensor_bridge.sources import (
    LEAST_OUTLIER_PROBABILITY,
    MAX_KNOWN,
    RECENT_STEPS,
    Source,
    Sources,
    beta_below_half,
    source_name,
)
from tests.unit.evaluation import places

TAGS = (Landmark(name="tag", x=1.0, y=2.0, sigma=0.1),)
EYE: Source = ("eye", "tag")
AT = (0.0, 2.0, 0.0)
EVEN: Covariance = (0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01)
HERE = places.place(1.0, AT, covariance=EVEN)
SURE = replace(places.belief(0, "localized", HERE), odom_from_robot=AT)
RIGHT, WRONG = (1.0, 0.0), (4.0, 1.0)


def sight(mean: Sequence[float], share: float = 1.0) -> Sighting:
    return Sighting(np.array(mean), 0.01 * np.eye(2), 0.05, share, landmark="tag")


def broken_after(sources: Sources, seen: Observed, belief: Belief = SURE, of: Source = EYE) -> bool:
    sources.on_observation(belief.step, of, seen, seen.share)
    sources.on_belief(belief)
    return sources.is_broken(of)


def test_two_wrong_observations_mark_a_source_as_broken_and_right_ones_restore_it() -> None:
    sources = Sources(TAGS)
    assert [broken_after(sources, sight(WRONG)) for _ in range(3)] == [False, True, True]
    for _ in range(20):
        broken_after(sources, sight(WRONG))
    mended = [broken_after(sources, sight(RIGHT)) for _ in range(10)]
    assert mended[0]
    assert not mended[-1]
    assert not sources.is_broken(("eye", "other"))


@pytest.mark.parametrize("kind", [PositionFix, PoseFix])
def test_sources_of_poses_are_checked_too(kind: type[PositionFix]) -> None:
    sources, gnss, size = Sources(()), ("gnss", ""), 3 if kind is PoseFix else 2
    here = kind(np.array(AT[:size]), 0.01 * np.eye(size), 0.05)
    for _ in range(10):
        assert not broken_after(sources, here, of=gnss)
    away = dataclasses.replace(here, mean=np.array([30.0, *AT[1:size]]))
    assert [broken_after(sources, away, of=gnss) for _ in range(20)][-1]


def test_a_repeated_observation_counts_by_its_new_share() -> None:
    sources = Sources(TAGS)
    assert not any(broken_after(sources, sight(WRONG, share=0.02)) for _ in range(50))


def test_an_uncertain_belief_does_not_update_sources() -> None:
    sources = Sources(TAGS)
    for belief in (replace(SURE, state="ambiguous"), replace(SURE, hypotheses=())):
        assert not any(broken_after(sources, sight(WRONG), belief) for _ in range(5))
    sources.on_observation(7, EYE, sight(WRONG), 1.0)
    sources.on_belief(SURE)  # of an earlier step
    assert not sources.is_broken(EYE)


def test_a_belief_without_spread_is_used() -> None:
    """Rounding may give a variance just below zero."""
    flat = replace(SURE, hypotheses=(replace(HERE, covariance=(-1e-18,) * 9),))
    sources = Sources(TAGS)
    assert [broken_after(sources, sight(WRONG), flat) for _ in range(2)][-1]


def test_the_last_of_many_tags_is_judged_and_health_shows_the_worst() -> None:
    sources, count = Sources(TAGS), MAX_LANDMARKS
    names = [("eye", f"tag {number}") for number in range(count)]
    for of in names[:-1]:
        assert not broken_after(sources, sight(RIGHT), of=of)
    assert [broken_after(sources, sight(WRONG), of=names[-1]) for _ in range(2)][-1]
    shown = sources.health()
    assert (len(shown), shown[0].name) == (MAX_SOURCES, source_name(names[-1]))


def test_a_flood_of_senders_is_bounded() -> None:
    sources = Sources(TAGS)
    for number in range(MAX_KNOWN + 5):
        assert [broken_after(sources, sight(WRONG), of=(f"eye{number}", "tag")) for _ in range(2)][
            -1
        ]
    assert [sources.is_broken((f"eye{number}", "tag")) for number in (4, 5)] == [False, True]
    assert len(source_name(("e\n" * 200, "tag"))) < 100


def test_what_a_source_states_is_believed_once_it_was_compared() -> None:
    sources, stated = Sources(TAGS), dataclasses.replace(sight(RIGHT), outlier_probability=1e-6)
    believed = []
    for _ in range(5):
        believed.append(sources.as_known(EYE, stated).outlier_probability)
        broken_after(sources, stated)
    assert believed == [LEAST_OUTLIER_PROBABILITY] * 3 + [1e-6] * 2


def test_health_shows_what_each_source_contributed_and_whether_it_is_broken() -> None:
    sources = Sources(TAGS)
    for step in range(3):
        for mean, of in ((RIGHT, EYE), (WRONG, ("bad", "tag"))):
            sources.on_observation(step, of, sight(mean), 0.5)
        sources.on_belief(replace(SURE, step=step))
    good, bad = sources.health()
    assert (good.name, bad.name) == ("eye tag", "bad tag")
    # Right with 0.95; the rest are half of this name and half of none, within 314 m^2. Tag, sight,
    # place and its heading at 1 m have a variance of 0.01 m^2 each.
    ratio = (19.0 * 2.0 + 1.0) * 314.16 / (2.0 * np.pi * 0.04)
    assert good.recent_nat == pytest.approx(3 * 0.5 * np.log1p(ratio), rel=1e-4)
    assert bad.recent_nat == pytest.approx(0.0, abs=1e-6)
    assert good.outlier_rate < 0.05
    assert bad.outlier_rate > 0.5
    assert good.broken_probability < 0.01
    assert bad.broken_probability > 0.6
    sources.on_belief(replace(SURE, step=2 + RECENT_STEPS))
    assert [each.recent_nat for each in sources.health()] == [0.0, 0.0]


def test_the_distribution_of_the_outlier_rate_is_beta() -> None:
    assert beta_below_half(1.0, 1.0) == pytest.approx(0.5)
    assert beta_below_half(1.0, 3.0) == pytest.approx(1.0 - 0.5**3)
    assert beta_below_half(3.0, 1.0) == pytest.approx(0.5**3)
    rng = np.random.default_rng(1)
    for a, b in ((0.1, 1.9), (2.5, 1.2), (9.9, 0.1)):
        drawn = rng.beta(a, b, 40_000) < 0.5
        assert beta_below_half(a, b) == pytest.approx(drawn.mean(), abs=0.012)  # 4.8 sigma
