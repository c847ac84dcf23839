import numpy as np

from coordinator.membership.order_delivery import RESEND_AFTER_NS, OrderDelivery
from particle_filter.settings import FilterSettings
from protocol.arrays import ArrayBlob
from protocol.work import Assignment, OrderAnswer, Particles, SearchJob, TrackJob, WorkOrder

SECOND = 1_000_000_000
Epochs = dict[str, int]


class Told(OrderDelivery):
    """One worker, and what it should do."""

    def __init__(self, *, silent_until_ns: int = 0) -> None:
        super().__init__("coordinator", FilterSettings(), snapshot_every_steps=10)
        self.joined("w", silent_until_ns)
        self.jobs: Epochs = {}
        self.copies: list[Assignment] = []

    def due(self, now_ns: int) -> WorkOrder | None:
        orders = self.orders(
            self.ready(now_ns), {"w": self.jobs}, self._assigned, copies={"w": self.copies},
            term=3, map_digest="map", now_ns=now_ns,
        )  # fmt: skip
        return dict(orders).get("w")

    def _assigned(self, job_id: str) -> Assignment:
        job = SearchJob(search=0, shard=0, first_step=0)
        return Assignment(job_id=job_id, epoch=self.jobs[job_id], job=job)

    def answer(
        self, order: WorkOrder | None, jobs: Epochs, problem: str = "", copies: Epochs | None = None
    ) -> None:
        assert order is not None
        self.answered(
            "w",
            OrderAnswer(
                sender="w", order=order.order, incarnation=1, problem=problem,
                jobs=tuple((job_id, epoch, 0) for job_id, epoch in jobs.items()),
                copies=tuple((copies or {}).items()),
            ),
        )  # fmt: skip


def test_a_newcomer_is_told_even_that_it_has_nothing_to_do() -> None:
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


def copy_of(job_id: str, step: int) -> Assignment:
    start = Particles(
        step=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(np.zeros((1, 3)), "float64"),
        log_weights=ArrayBlob.of(np.zeros(1), "float64"),
    )
    job = TrackJob(cluster=0, start=start, exact=True)
    return Assignment(job_id=job_id, epoch=1, job=job)


def test_a_copy_travels_until_it_is_confirmed_and_then_no_more() -> None:
    made = Told()
    made.copies = [copy_of("c0", 5)]
    order = made.due(0)
    assert order is not None
    assert (order.copies, order.new_copies) == ((("c0", 5),), (copy_of("c0", 5),))
    assert not made.has_copy("c0", "w")
    order = made.due(RESEND_AFTER_NS)
    assert order is not None
    assert order.new_copies == (copy_of("c0", 5),)
    made.answer(order, {}, copies={"c0": 5})
    assert made.has_copy("c0", "w")
    made.copies.append(copy_of("c1", 6))
    order = made.due(RESEND_AFTER_NS)
    assert order is not None
    assert (order.copies, order.new_copies) == ((("c0", 5), ("c1", 6)), (copy_of("c1", 6),))


def test_one_of_an_older_release_that_keeps_no_copies_is_not_asked_again() -> None:
    made = Told()
    made.copies = [copy_of("c0", 5)]
    made.answer(made.due(0), {})
    assert not made.has_copy("c0", "w")
    assert made.due(9 * RESEND_AFTER_NS) is None


def test_one_that_is_not_known_has_no_copy() -> None:
    made = Told()
    assert not made.has_copy("c0", "w")
    assert not made.has_copy("c0", "x")
    assert not made.has_copy("c0", None)
