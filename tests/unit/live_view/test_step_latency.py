from live_view.live_loop import LAST_STEPS, StepLatency

MS = 1_000_000


def test_the_latency_of_a_step_ends_with_its_first_belief() -> None:
    latency = StepLatency()
    assert latency.frame() is None
    latency.on_scan(1, 0)
    latency.on_scan(2, 100 * MS)
    latency.on_belief(1, 10 * MS)
    latency.on_belief(2, 130 * MS)
    latency.on_belief(2, 900 * MS)  # a command has changed it
    assert latency.frame() == {"last": 30.0, "median": 20.0, "most": 30.0, "steps": 2}


def test_a_belief_without_its_scan_has_no_latency() -> None:
    latency = StepLatency()
    latency.on_belief(7, MS)
    assert latency.frame() is None


def test_only_the_last_steps_count() -> None:
    latency = StepLatency()
    for step in range(LAST_STEPS + 1):
        latency.on_scan(step, 0)
        latency.on_belief(step, (500 if step == 0 else 5) * MS)
    assert latency.frame() == {"last": 5.0, "median": 5.0, "most": 5.0, "steps": LAST_STEPS}
