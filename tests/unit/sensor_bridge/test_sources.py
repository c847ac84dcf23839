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
    Source,
    Sources,
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
    sources.on_observation(belief.step, of, seen)
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
    sources.on_observation(7, EYE, sight(WRONG))
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
    assert shown[0].outlier_rate > 0.5 > shown[1].outlier_rate


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
