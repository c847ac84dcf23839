from process_runtime.watchdog import HangDetector


def first_hang(signs: set[int], asked: range | list[int], hung_after_s: float = 10.0) -> int | None:
    """The first second at which the process is said to hang."""
    detector = HangDetector(hung_after_s)
    for now_s in asked:
        if now_s in signs:
            detector.heard(now_s)
        if detector.hangs(now_s):
            return now_s
    return None


def test_silence_after_a_sign_is_a_hang() -> None:
    assert first_hang({3, 5}, range(60)) == 16


def test_who_never_gave_a_sign_knows_of_none_and_does_not_hang() -> None:
    assert first_hang(set(), range(60)) is None


def test_who_gives_signs_does_not_hang() -> None:
    assert first_hang(set(range(0, 60, 10)), range(60)) is None


def test_the_silence_counts_anew_when_the_one_who_asks_was_stopped_too() -> None:
    assert first_hang({5}, [*range(8), *range(100, 105)]) is None
    assert first_hang({5}, [*range(8), *range(100, 160)]) == 111
