import pytest

from clustermcl.commands.demo_output import DemoOutput, DemoSummary
from clustermcl.protocol.job_events import Ended, NumberedEvent
from tests.unit.evaluation.places import STATUS, belief, place

END = "40 steps, 1 lost, 1 workers, 3.0 s."


def test_the_summary_lists_held_places_and_the_step_of_the_decision() -> None:
    summary = DemoSummary()
    assert list(summary.lines(STATUS, 3.0)) == [END]
    summary.on_belief(belief(0, "searching"))
    for step in (1, 2):
        summary.on_belief(
            belief(step, "ambiguous", place(0.5), place(0.3), place(0.19), place(0.01))
        )
    for event in (
        Ended("c2", "merged", ("c0",), 0.19),
        Ended("c3", "merged", ("c0",), 0.01),
        Ended("c4", "pushed out", ("c5",), 0.01),
        Ended("s0.0", "search over"),
    ):
        summary.on_event(NumberedEvent(number=0, step=2, stamp_ns=0, event=event))
    for step in (3, 4, 5):
        summary.on_belief(belief(step, "localized", place(0.97), place(0.03)))
    assert list(summary.lines(STATUS, 3.0)) == [
        "The search found its first places at step 1.",
        "For 2 steps up to 3 places were tracked, with probabilities from 0.19 to 0.50.",
        "Dropped places: 2 merged, 1 pushed out.",
        "From step 3 on the robot was localized.",
        "At the end localized with probability 0.97: "
        "x 0.00 m  y 0.00 m  heading 0.0 deg  +-0.20 m, 2.9 deg",
        END,
    ]
    assert summary.localized_steps == 3
    summary.on_belief(belief(6, "ambiguous", place(0.5), place(0.5)))
    assert summary.localized_steps == 0


def test_places_below_one_per_cent_change_no_line(capsys: pytest.CaptureFixture[str]) -> None:
    output = DemoOutput("robot", as_json=False)
    output.on_belief(belief(1, "ambiguous", place(0.5), place(0.49), place(0.009)), None)
    dropped = Ended("c2", "improbable", (), 0.009), Ended("c1", "merged", ("c0",), 0.49)
    output.on_events(NumberedEvent(number=0, step=2, stamp_ns=0, event=each) for each in dropped)
    output.on_belief(belief(2, "ambiguous", place(0.5), place(0.49)), None)
    first, merged = capsys.readouterr().out.splitlines()
    assert "probabilities 0.50, 0.49, 1 more" in first
    assert merged == "step 2: place 1 merged into place 0 (49 %)"


def test_the_first_step_that_is_localized_at_the_true_pose_is_named() -> None:
    summary = DemoSummary()
    for step, state, off_m in (
        (0, "ambiguous", 0.0), (1, "localized", 5.0), (2, "localized", 0.2), (3, "localized", 0.0),
    ):  # fmt: skip
        summary.on_belief(belief(step, state, place(0.95)), (off_m, 0.0, 0.0))
    assert summary.found_step == 2
    lines = list(summary.lines(STATUS, 3.0, DemoSummary()))
    assert "First localized at the true pose: step 2." in lines
    assert lines[-3:] == ["That is 0.00 m and 0.0 deg off.", END, "The robot that wandered: never."]
