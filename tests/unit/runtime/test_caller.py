import sys

import pytest

from clustermcl.protocol.message import MAX_ID_CHARACTERS
from clustermcl.runtime.caller import caller


@pytest.mark.parametrize(
    ("started", "program", "expected"),
    [
        ("/opt/bin/clustermcl", "", "clustermcl of "),
        ("/opt/lib/clustermcl/__main__.py", "", "clustermcl of "),
        ("", "", "python of "),
        ("/opt/bin/anything", "live_view", "live_view of "),
        (200 * "x", "", 128 * "x"),
    ],
)
def test_a_command_names_program_user_and_host(
    monkeypatch: pytest.MonkeyPatch, started: str, program: str, expected: str
) -> None:
    monkeypatch.setattr(sys, "argv", [started])
    caller.cache_clear()
    assert caller(program).startswith(expected)
    assert len(caller(program)) <= MAX_ID_CHARACTERS
    caller.cache_clear()
