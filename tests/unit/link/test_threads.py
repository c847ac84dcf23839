import os

import pytest

from clustermcl.link import session
from clustermcl.link.session import MANY_LINKS, ONE_LINK, VARIABLE, receiving_threads


@pytest.fixture(autouse=True)
def new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_read", False)
    monkeypatch.delenv(VARIABLE, raising=False)


def test_the_thread_variable_is_set_only_while_a_session_opens() -> None:
    with receiving_threads(MANY_LINKS):
        assert os.environ[VARIABLE] == MANY_LINKS
    assert VARIABLE not in os.environ


def test_the_thread_variable_is_removed_if_the_session_does_not_open() -> None:
    with pytest.raises(ZeroDivisionError), receiving_threads(ONE_LINK):
        raise ZeroDivisionError
    assert VARIABLE not in os.environ


def test_only_the_first_session_of_a_process_sets_the_variable() -> None:
    with receiving_threads(MANY_LINKS):
        pass
    with receiving_threads(ONE_LINK):
        assert VARIABLE not in os.environ


def test_a_variable_set_by_the_user_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "(rx: (worker_threads: 40))")
    with receiving_threads(MANY_LINKS):
        assert os.environ[VARIABLE] == "(rx: (worker_threads: 40))"
    assert os.environ[VARIABLE] == "(rx: (worker_threads: 40))"
