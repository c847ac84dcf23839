import os

import psutil

from soak_test.resources import WARM_UP_S, Resources

ME = psutil.Process(os.getpid())


def test_a_coordinator_that_begins_to_act_begins_another_life_of_its_process() -> None:
    resources = Resources()
    for acts in (False, False, True):
        resources.sample([("robot/coordinator", ME, acts)])
    waits, acts = resources.lives["robot/coordinator"].values()
    assert (len(waits.times_s), len(acts.times_s)) == (2, 1)
    assert waits.begun_s == ME.create_time()
    assert acts.begun_s == acts.times_s[0]


def test_what_a_coordinator_needs_to_act_is_no_growth() -> None:
    resources = Resources()
    for acts in (False, True):
        resources.sample([("robot/coordinator", ME, acts)])
    lives = resources.lives["robot/coordinator"].values()
    for life, megabytes in zip(lives, (25, 38), strict=True):
        life.times_s = [life.begun_s + WARM_UP_S + 3.0 * k for k in range(400)]
        life.memory_mb = [float(megabytes)] * 400
    slope = resources.slope("robot/coordinator", lambda life: life.memory_mb)
    assert slope is not None
    assert slope.per_hour == 0.0


def test_one_that_acts_from_its_beginning_has_one_life() -> None:
    resources = Resources()
    for _ in range(2):
        resources.sample([("robot/coordinator", ME, True)])
    (life,) = resources.lives["robot/coordinator"].values()
    assert life.begun_s == ME.create_time()
