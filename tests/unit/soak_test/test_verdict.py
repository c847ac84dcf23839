from soak_test.verdict import Break, Verdict, over_all


def verdict(kept: bool | None, breaks: int = 0) -> Verdict:
    return Verdict(
        promise="p",
        target="t",
        measured=f"{kept} {breaks}",
        kept=kept,
        breaks=(Break(0, "x"),) * breaks,
    )


def test_the_robot_for_which_it_went_worst_speaks_for_all() -> None:
    robots = {"a": [verdict(True)], "b": [verdict(False, 1)], "c": [verdict(False, 3)]}
    assert over_all(robots)[0].measured == "False 3 (c)"
    assert over_all({"a": [verdict(True)], "b": [verdict(None)]})[0].kept is None
    assert over_all({"a": [verdict(True)]})[0].kept is True
