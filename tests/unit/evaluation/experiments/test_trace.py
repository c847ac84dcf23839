from evaluation.experiments.trace import Trace, TracePlace, TraceStep


def step(probability: float, *, right: bool, truth_probability: float) -> TraceStep:
    place = TracePlace(cluster=1, probability=probability, position=(0.0, 0.0))
    return TraceStep(0, (0.0, 0.0, 0.0), right, truth_probability, (place,))


def test_a_run_is_summed_up_in_a_line_for_its_plots() -> None:
    steps = [
        step(0.95, right=False, truth_probability=0.05),
        step(0.80, right=False, truth_probability=0.20),
        step(0.95, right=True, truth_probability=0.95),
        TraceStep(3, (0.0, 0.0, 0.0), False, 0.0, ()),
    ]
    assert Trace(seed=0, steps=steps).finding == (
        "the right place was given 30%, sure of a wrong one on 25% of all updates"
    )
