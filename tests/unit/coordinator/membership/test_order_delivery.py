from coordinator.order_delivery import RESEND_AFTER_NS, OrderDelivery
from particle_filter.settings import FilterSettings
from protocol.work import Assignment, OrderAnswer, SearchJob, WorkOrder

SECOND = 1_000_000_000
Epochs = dict[str, int]


class Told(OrderDelivery):
    """One worker, and what it should do."""

    def __init__(self, *, silent_until_ns: int = 0) -> None:
        super().__init__("coordinator", FilterSettings(), snapshot_every_steps=10)
        self.joined("w", silent_until_ns)
        self.jobs: Epochs = {}

    def due(self, now_ns: int) -> WorkOrder | None:
        orders = self.orders(
            self.ready(now_ns),
            {"w": self.jobs},
            self._assigned,
            term=3,
            map_digest="map",
            now_ns=now_ns,
        )
        return dict(orders).get("w")

    def _assigned(self, job_id: str) -> Assignment:
        job = SearchJob(search=0, shard=0, first_step=0)
        return Assignment(job_id=job_id, epoch=self.jobs[job_id], job=job)

    def answer(self, order: WorkOrder | None, jobs: Epochs, problem: str = "") -> None:
        assert order is not None
        self.answered(
            "w",
            OrderAnswer(
                sender="w", order=order.order, problem=problem,
                jobs=tuple((job_id, epoch, 0) for job_id, epoch in jobs.items()),
            ),
        )  # fmt: skip


def test_a_candidate_is_told_even_that_it_has_nothing_to_do() -> None:
    made = Told()
    order = made.due(0)
    assert order is not None
    assert (order.term, order.map_digest, order.keep, order.begin) == (3, "map", (), ())
    made.answer(order, {})
    assert made.due(9 * SECOND) is None


def test_what_has_changed_since_the_last_order_is_told_at_once() -> None:
    made = Told()
    made.answer(made.due(0), {})
    for jobs in ({"c0": 1}, {"c0": 2}, {"c0": 2, "c1": 3}, {}):
        made.jobs = dict(jobs)
        made.answer(made.due(1), jobs)
        assert made.due(1) is None


def test_jobs_that_are_confirmed_are_kept_and_the_others_begun() -> None:
    made = Told()
    made.jobs = {"c0": 1}
    made.answer(made.due(0), made.jobs)
    made.jobs = {"c1": 2, "c0": 1}
    order = made.due(1)
    assert order is not None
    assert order.keep == (("c0", 1),)
    assert [(a.job_id, a.epoch) for a in order.begin] == [("c1", 2)]


def test_a_refused_order_is_repeated() -> None:
    made = Told()
    made.answer(made.due(0), {}, problem="another map")
    assert not made.has_answered("w")
    assert made.due(RESEND_AFTER_NS - 1) is None
    assert made.due(RESEND_AFTER_NS) is not None


def test_an_answer_without_all_that_was_ordered_is_none() -> None:
    made = Told()
    made.jobs = {"c0": 1}
    made.answer(made.due(0), {})
    assert not made.has_answered("w")


def test_one_that_is_being_asked_gets_no_order_before_it_has_told() -> None:
    made = Told(silent_until_ns=SECOND)
    made.jobs = {"s0.0": 4}
    assert made.due(SECOND - 1) is None
    made.held("w", [made._assigned("s0.0")])
    order = made.due(1)
    assert order is not None
    assert order.keep == (("s0.0", 4),)
