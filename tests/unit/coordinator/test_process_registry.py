from clustermcl.coordinator.loop import FORGOTTEN_AFTER_NS, MAX_PROCESSES, ProcessRegistry
from clustermcl.protocol.health import Health

SECOND = 1_000_000_000


def health(name: str, role: str = "worker", uptime_s: float = 1.0) -> Health:
    return Health(sender=name, role=role, version="1", uptime_s=uptime_s)


def test_the_newest_health_of_each_process_is_shown_with_its_age_until_it_is_silent() -> None:
    board = ProcessRegistry()
    board.on_health("worker/b/health", health("b"), 0)
    board.on_health("bridge/health", health("bridge", "bridge"), SECOND)
    board.on_health("worker/a/health", health("a"), SECOND)
    board.on_health("worker/a/health", health("a", uptime_s=2.0), 2 * SECOND)
    shown = [(one.sender, one.uptime_s, one.age_s) for one in board.all(3 * SECOND)]
    assert shown == [("bridge", 1.0, 2.0), ("a", 2.0, 1.0), ("b", 1.0, 3.0)]
    assert [one.sender for one in board.all(FORGOTTEN_AFTER_NS + SECOND)] == ["a"]


def test_thousands_of_invented_names_are_not_kept() -> None:
    board = ProcessRegistry()
    took = [board.on_health(str(n), health(str(n)), 0) for n in range(MAX_PROCESSES + 9)]
    assert took.count(False) == 9
    assert board.on_health("worker/new/health", health("new"), FORGOTTEN_AFTER_NS)
    assert len(board.all(FORGOTTEN_AFTER_NS)) == 1
