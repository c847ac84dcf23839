import os
from contextlib import suppress

import pytest

from clustermcl.link import session
from clustermcl.link.session import MANY_LINKS, ONE_LINK, VARIABLE, receiving_threads


@pytest.fixture(autouse=True)
def new_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_read", False)
    monkeypatch.delenv(VARIABLE, raising=False)


def test_the_first_session_of_a_process_alone_sets_the_variable_and_only_while_it_opens() -> None:
    with suppress(ZeroDivisionError), receiving_threads(MANY_LINKS):
        assert os.environ[VARIABLE] == MANY_LINKS
        raise ZeroDivisionError
    assert VARIABLE not in os.environ
    with receiving_threads(ONE_LINK):
        assert VARIABLE not in os.environ


def test_a_variable_set_by_the_user_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "(rx: (worker_threads: 40))")
    with receiving_threads(MANY_LINKS):
        assert os.environ[VARIABLE] == "(rx: (worker_threads: 40))"
    assert os.environ[VARIABLE] == "(rx: (worker_threads: 40))"
