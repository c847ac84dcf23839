import logging

import pytest

from clustermcl.runtime.logs import CauseCounter
from tests.unit.programs import ran


def test_a_warning_is_logged_once_a_minute_with_cause_count_and_detail(
    caplog: pytest.LogCaptureFixture,
) -> None:
    causes, log = CauseCounter(), logging.getLogger("test")
    for now_s in (0.0, 1.0, 59.9, 60.0, 61.0):
        causes.warn(log, "scan dropped", "no beams", now_s)
    assert caplog.messages == ["scan dropped: no beams", "scan dropped (3 times): no beams"]
    assert causes.total == {"scan dropped": 5}


def test_a_message_is_one_line_on_standard_error_with_the_process_in_front() -> None:
    program = (
        "import logging; from clustermcl.runtime.logs import configure_logging as c;"
        "c('early', 'debug'); c('50% worker-3', 'info'); log = logging.getLogger('x');"
        "log.debug('hidden'); log.info('two\\nlines %s \\x1b]0;title\\x07\\u202e', 1)"
    )
    ended = ran(program)
    assert ended.stdout == ""
    assert len(ended.stderr.splitlines()) == 1
    assert ended.stderr.endswith(
        "INFO    50% worker-3: two | lines 1 \\u001b]0;title\\u0007\\u202e\n"
    )
