"""The reports of a worker on one step share a message."""

import msgpack
import pytest
from msgspec.structs import replace

from clustermcl.protocol import work
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from tests.unit.coordinator.reports import cloud_at, elsewhere, searched, tracked

PLAIN = tracked("c0", 1, 0.5, (0.0, 0.0, 0.0))
SEARCHED = searched("s0.0", 1, {(0.0, 0.0, 0.0): 1.0})
WITH_PARTICLES = replace(PLAIN, job_id="c9", snapshot=cloud_at((0.0, 0.0, 0.0), 3))


@pytest.mark.parametrize(
    ("reports", "sizes"),
    [
        pytest.param([], [], id="none"),
        pytest.param([PLAIN], [1], id="one alone is no batch"),
        pytest.param([PLAIN, elsewhere(1, -1.0), PLAIN], [3], id="a step of several jobs"),
        pytest.param([PLAIN, PLAIN, WITH_PARTICLES, PLAIN], [2, 1, 1], id="particles alone"),
        pytest.param([SEARCHED, SEARCHED], [1, 1], id="searches alone"),
        pytest.param(
            [PLAIN] * (2 * work.MAX_BATCH + 1), [work.MAX_BATCH, work.MAX_BATCH, 1], id="many steps"
        ),
    ],
)
def test_reports_keep_their_order_in_few_messages(
    reports: list[work.Report], sizes: list[int]
) -> None:
    messages = [decode(encode(one), work.Reported) for one in work.in_few_messages(reports)]  # type: ignore[arg-type] # a union
    assert [len(work.reports_in(one)) for one in messages] == sizes
    assert [report for one in messages for report in work.reports_in(one)] == reports


def batch_of(*reports: object) -> bytes:
    return msgpack.packb({"schema": "report_batch/1", "sender": "w", "reports": reports})


def plain(report: work.Report | work.ReportBatch) -> object:
    return msgpack.unpackb(encode(report))


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(batch_of(plain(PLAIN)), id="too few"),
        pytest.param(batch_of(*[plain(PLAIN)] * (work.MAX_BATCH + 1)), id="too many"),
        pytest.param(batch_of(plain(PLAIN), plain(SEARCHED)), id="a search"),
        pytest.param(
            batch_of(plain(PLAIN), plain(work.ReportBatch(sender="w", reports=(PLAIN, PLAIN)))),
            id="a batch in a batch",
        ),
        pytest.param(
            batch_of(plain(PLAIN), plain(replace(PLAIN, covariance=(float("nan"),) * 9))),
            id="not a number",
        ),
        pytest.param(
            batch_of(plain(PLAIN), plain(replace(PLAIN, log_likelihood_per_beam=float("inf")))),
            id="an infinite likelihood",
        ),
    ],
)
def test_an_impossible_batch_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        decode(data, work.Reported)  # type: ignore[arg-type] # a union
