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
        ([], []),
        ([PLAIN, elsewhere(1, -1.0), PLAIN], [3]),
        ([PLAIN, PLAIN, WITH_PARTICLES, PLAIN], [2, 1, 1]),
        ([SEARCHED, SEARCHED], [1, 1]),
        ([PLAIN] * (2 * work.MAX_BATCH + 1), [work.MAX_BATCH, work.MAX_BATCH, 1]),
    ],
)
def test_reports_keep_their_order_in_few_messages(
    reports: list[work.Report], sizes: list[int]
) -> None:
    messages = [decode(encode(one), work.Reported) for one in work.in_few_messages(reports)]  # type: ignore[arg-type] # a union
    assert [len(work.reports_in(one)) for one in messages] == sizes
    assert [report for one in messages for report in work.reports_in(one)] == reports


@pytest.mark.parametrize(
    "reports",
    [
        [PLAIN],
        [PLAIN] * (work.MAX_BATCH + 1),
        [PLAIN, SEARCHED],
        [PLAIN, work.ReportBatch(sender="w", reports=(PLAIN, PLAIN))],
        [PLAIN, replace(PLAIN, covariance=(float("nan"),) * 9)],
    ],
    ids=["too few", "too many", "a search", "a batch in a batch", "not a number"],
)
def test_an_impossible_batch_is_refused(reports: list[work.Report | work.ReportBatch]) -> None:
    plain = [msgpack.unpackb(encode(report)) for report in reports]
    data = msgpack.packb({"schema": "report_batch/1", "sender": "w", "reports": plain})
    with pytest.raises(MalformedMessageError):
        decode(data, work.Reported)  # type: ignore[arg-type] # a union
