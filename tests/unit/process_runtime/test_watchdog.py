from process_runtime.watchdog import HangDetector


def first_hang(signs: set[int], asked: range | list[int], hung_after_s: float = 10.0) -> int | None:
    """The first second at which the process is said to hang."""
    detector = HangDetector(hung_after_s)
    for now_s in asked:
        if now_s in signs:
            detector.on_sign(now_s)
        if detector.hangs(now_s):
            return now_s
    return None


def test_silence_after_a_sign_is_a_hang() -> None:
    assert first_hang({3, 5}, range(60)) == 16


def test_a_process_without_signs_of_life_does_not_count_as_hanging() -> None:
    assert first_hang(set(), range(60)) is None


def test_a_process_with_signs_of_life_does_not_hang() -> None:
    assert first_hang(set(range(0, 60, 10)), range(60)) is None


def test_the_silence_counts_again_when_the_asking_process_was_stopped_too() -> None:
    assert first_hang({5}, [*range(8), *range(100, 105)]) is None
    assert first_hang({5}, [*range(8), *range(100, 160)]) == 111
