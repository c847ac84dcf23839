import msgspec
import pytest

from coordinator.coordinator import SIGN_OF_LIFE_NS, STEPS_AT_ONCE, Coordinator, Started
from coordinator.events import (
    CommandArrived,
    HistoryArrived,
    LinkChanged,
    MapArrived,
    OdometryArrived,
    OrderAnswered,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerJoined,
    WorkerSnapshot,
    WorkerStateArrived,
)
from coordinator.instructions import (
    AnswerCommand,
    AskState,
    FetchMap,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    PublishEvents,
    SendOrder,
)
from particle_filter.settings import FilterSettings, SearchSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import Belief, Relocalize, SetPose
from protocol.codec import decode, encode
from protocol.job_events import Began, Ended, JobEvents
from protocol.steps import OdometryReading
from protocol.work import Checkpoint, OrderAnswer, Report, SearchJob, WorkOrder
from tests.unit.coordinator.reports import (
    NO_SPREAD,
    free_everywhere,
    literal_bayes,
    scan,
    searched,
    tracked,
)

SECOND = 1_000_000_000
NORTH, SOUTH = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0)


class Story:
    """A coordinator and obedient workers that report what the story says."""

    def __init__(
        self,
        *workers: str,
        rules: CoordinatorSettings = CoordinatorSettings(),  # noqa: B008 - frozen
        kept: Checkpoint | None = None,
        known: Checkpoint | None = None,
        **belief: object,
    ) -> None:
        settings = FilterSettings(
            search=SearchSettings(shards=1), belief=literal_bayes(**{"max_clusters": 3, **belief})
        )
        self.coordinator = Started(
            sender="coordinator",
            filter_settings=settings,
            settings=rules,
            version="test",
            now_ns=0,
            known=known,
            kept=kept,
        ).coordinator()
        self.has_map = True
        self.checkpoints: list[Checkpoint] = []
        self.epochs: dict[str, int] = {}
        self.places: dict[str, str] = {}
        self.beliefs: list[Belief] = []
        self.reported: list[Belief | JobEvents] = []
        for worker in workers:
            self.follow(self.coordinator.handle(WorkerJoined(worker), 0))

    def follow(self, instructions: list[Instruction]) -> None:
        for instruction in instructions:
            match instruction:
                case PublishBelief(belief=belief):
                    self.beliefs.append(decode(encode(belief), Belief))
                    self.reported.append(belief)
                case PublishCheckpoint(checkpoint=checkpoint):
                    self.checkpoints.append(checkpoint)
                case PublishEvents(events=events):
                    self.reported.append(decode(encode(events), JobEvents))
                case FetchMap() if self.has_map:
                    ground = free_everywhere(self.coordinator.state.map_digest)
                    self.follow(self.coordinator.handle(MapArrived(ground), 0))
                case FetchScans(last=last) if last is not None:
                    self.follow(self.coordinator.handle(HistoryArrived(()), 0))
                case AskState(worker=worker):
                    nothing = WorkerSnapshot(term=0)
                    self.follow(self.coordinator.handle(WorkerStateArrived(worker, nothing), 0))
                case SendOrder(worker=worker, order=order):
                    for assignment in order.begin:
                        self.epochs[assignment.job_id] = assignment.epoch
                        self.places[assignment.job_id] = worker
                    jobs = (*order.keep, *((a.job_id, a.epoch) for a in order.begin))
                    answer = OrderAnswer(
                        sender=worker, order=order.order,
                        jobs=tuple((job_id, epoch, 0) for job_id, epoch in jobs),
                    )  # fmt: skip
                    self.coordinator.handle(OrderAnswered(worker, answer), 0)

    def scan(self, step: int, *, at_s: float) -> None:
        self.follow(self.coordinator.handle(ScanArrived(scan(step)), int(at_s * SECOND)))

    def report(self, report: Report, *, at_s: float) -> None:
        worker = self.places[report.job_id]
        self.follow(self.coordinator.handle(ReportArrived(worker, report), int(at_s * SECOND)))

    def bootstrapped(self) -> "Story":
        self.scan(0, at_s=0.0)
        places = {NORTH: 0.5, SOUTH: 0.5}
        self.report(searched("s0.0", 0, places, epoch=self.epochs["s0.0"]), at_s=0.1)
        return self

    def tracks(self, step: int, *, at_s: float, north: float, south: float | None) -> None:
        self.scan(step, at_s=at_s)
        one = tracked("c0", step, north, NORTH, epoch=self.epochs["c0"])
        self.report(one, at_s=at_s + 0.01)
        if south is not None:
            other = tracked("c1", step, south, SOUTH, epoch=self.epochs["c1"])
            self.report(other, at_s=at_s + 0.02)


def test_a_worker_cannot_report_another_workers_job() -> None:
    story = Story("a", "b").bootstrapped()
    story.scan(1, at_s=1.0)
    north = tracked("c0", 1, 0.1, NORTH, epoch=story.epochs["c0"])
    south = tracked("c1", 1, 0.1, SOUTH, epoch=story.epochs["c1"])
    forger = story.places["c0"]
    assert forger != story.places["c1"]
    forged = tracked("c1", 1, 1e9, SOUTH, epoch=story.epochs["c1"])
    story.follow(story.coordinator.handle(ReportArrived(forger, forged), SECOND))
    story.report(south, at_s=1.1)
    story.report(north, at_s=1.1)
    assert [h.probability for h in story.beliefs[-1].hypotheses] == pytest.approx([0.5, 0.5])
    status = story.coordinator.status(2 * SECOND, {})
    assert status.counters["report of another worker's job"] == 1


def test_events_are_published_before_their_belief_and_can_be_queried_afterwards() -> None:
    story = Story("a").bootstrapped()
    events, belief = story.reported
    assert isinstance(events, JobEvents)
    assert belief == story.beliefs[0]
    assert [(one.number, one.step, one.stamp_ns, one.event) for one in events.events] == [
        (0, 0, 0, Began("c0", "first search", pytest.approx(0.5))),
        (1, 0, 0, Began("c1", "first search", pytest.approx(0.5))),
        (2, 0, 0, Ended("s0.0", "search over")),
    ]
    story.tracks(1, at_s=1.0, north=0.3, south=0.1)
    assert story.reported[2:] == story.beliefs[1:], "nothing began or ended"
    forget = Relocalize(sender="client", command_id="1")
    story.follow(story.coordinator.handle(CommandArrived(forget), 2 * SECOND))
    forgotten = story.reported[3]
    assert isinstance(forgotten, JobEvents)
    assert forgotten.term == events.term == story.coordinator.pose(SECOND).term
    assert [one.event for one in forgotten.events] == [
        Ended("c0", "forgotten", (), pytest.approx(0.75)),
        Ended("c1", "forgotten", (), pytest.approx(0.25)),
    ]
    assert story.coordinator.events().events == (*events.events, *forgotten.events)


def test_clusters_end_with_the_cause_when_the_bridge_restarts_its_steps() -> None:
    story = Story("a").bootstrapped()
    for step in range(1, 9):
        story.tracks(step, at_s=float(step), north=0.1, south=0.1)
    for step in range(3):
        again = msgspec.structs.replace(scan(step), stamp_ns=(20 + step) * SECOND)
        story.follow(story.coordinator.handle(ScanArrived(again), (20 + step) * SECOND))
    causes = [
        one.event.cause
        for one in story.coordinator.events().events
        if isinstance(one.event, Ended) and one.event.job_id in ("c0", "c1")
    ]
    assert causes == ["steps restarted", "steps restarted"]


def tracking_story(rules: CoordinatorSettings = CoordinatorSettings()) -> Story:  # noqa: B008 - frozen
    story = Story("a", rules=rules).bootstrapped()
    for step in range(1, 5):
        story.tracks(step, at_s=float(step), north=0.1, south=0.1)
    return story


def test_a_bridge_with_another_map_begins_a_search_in_that_map() -> None:
    story = tracking_story()
    orders: list[WorkOrder] = []
    for step in range(5, 8):
        event = ScanArrived(scan(step, digest="new map"))
        instructions = story.coordinator.handle(event, step * SECOND)
        orders += [do.order for do in instructions if isinstance(do, SendOrder)]
        assert story.coordinator.state.map_digest == ("map" if step < 7 else "new map")
        story.follow(instructions)
    (order,) = orders
    assert order.map_digest == "new map"
    assert order.keep == ()
    assert {one.job.first_step for one in order.begin if isinstance(one.job, SearchJob)} == {7}
    status = story.coordinator.status(8 * SECOND, {})
    assert status.map_digest == "new map"
    assert status.counters["map changed"] == 1
    assert (status.state, status.clusters) == ("searching", 0)
    causes = {
        one.event.job_id: one.event.cause
        for one in story.coordinator.events().events
        if isinstance(one.event, Ended)
    }
    assert (causes["c0"], causes["c1"]) == ("new map", "new map")
    places = {NORTH: 1.0}
    story.report(searched("s1.0", 7, places, epoch=story.epochs["s1.0"]), at_s=8.1)
    assert story.beliefs[-1].step == 7
    assert story.beliefs[-1].state == "localized"


def test_stray_scans_of_another_map_change_nothing() -> None:
    story = tracking_story()
    for step in range(5, 12):
        for stray in (step, step + 1):  # never three in a row
            event = ScanArrived(scan(stray, digest="new map"))
            assert story.coordinator.handle(event, step * SECOND) == []
        story.tracks(step, at_s=float(step), north=0.1, south=0.1)
    status = story.coordinator.status(12 * SECOND, {})
    assert (status.map_digest, status.clusters, status.step) == ("map", 2, 11)
    assert status.counters["scan of another map"] == 14
    assert "map changed" not in status.counters


def in_a_new_map(story: Story, *steps: int) -> None:
    for step in steps:
        reported = scan(step, x_m=1.0 + 0.1 * step, digest="new map")
        story.follow(story.coordinator.handle(ScanArrived(reported), step * SECOND))


def test_places_are_kept_in_a_new_map_if_so_configured() -> None:
    story = tracking_story(CoordinatorSettings(keep_pose_on_new_map=True))
    in_a_new_map(story, 5, 6, 7)
    status = story.coordinator.status(7 * SECOND, {})
    assert (status.map_digest, status.clusters, status.searching) == ("new map", 2, False)
    for job_id, place in (("c2", NORTH), ("c3", SOUTH)):
        story.report(tracked(job_id, 7, 0.1, place, epoch=story.epochs[job_id]), at_s=7.1)
    after = story.beliefs[-1]
    assert (after.step, after.state) == (7, "ambiguous")
    assert [place.probability for place in after.hypotheses] == pytest.approx([0.5, 0.5])
    causes = [e.event.cause for e in story.coordinator.events().events]
    assert (causes.count("new map"), causes.count("prior pose")) == (2, 2)


def test_places_kept_in_a_new_map_are_moved_by_odometry() -> None:
    story = tracking_story(CoordinatorSettings(keep_pose_on_new_map=True))
    in_a_new_map(story, 5, 6, 7)
    pose = story.coordinator.hypotheses(7 * SECOND)
    north, south = sorted((place.pose for place in pose.hypotheses), key=lambda mean: -mean[1])
    # The robot has driven on since the last step in the old map.
    assert north == pytest.approx((1.7, 5.0, 0.0))
    assert south == pytest.approx((1.7, -5.0, 0.0))
    wider = [place.covariance[0] for place in pose.hypotheses]
    assert min(wider) > NO_SPREAD[0]


def test_a_step_that_no_worker_weighed_makes_the_pose_dead_reckoning() -> None:
    story = tracking_story()
    for step in range(5, 12):
        event = ScanArrived(scan(step, x_m=0.2 * (step - 4)))
        story.follow(story.coordinator.handle(event, step * SECOND))
        story.follow(story.coordinator.handle(TimePassed(), int((step + 0.9) * SECOND)))
    pose = story.coordinator.pose(12 * SECOND)
    assert (pose.step, pose.freshness) == (11, "dead_reckoning")
    assert pose.scan_age_s == 8.0
    covariance = story.beliefs[-1].hypotheses[0].covariance
    assert covariance[0] > 1.5 * story.beliefs[4].hypotheses[0].covariance[0]


def test_decisions_are_sent_in_between_if_many_steps_are_due() -> None:
    story = tracking_story()
    for step in range(5, 5 + 2 * STEPS_AT_ONCE + 1):
        story.follow(story.coordinator.handle(ScanArrived(scan(step)), 5 * SECOND))
    reported = []
    for _ in range(4):
        before = len(story.beliefs)
        story.follow(story.coordinator.handle(TimePassed(), 60 * SECOND))
        reported.append(len(story.beliefs) - before)
    assert reported == [STEPS_AT_ONCE, STEPS_AT_ONCE, 1, 0]


def commanded(coordinator: Coordinator, command: SetPose | Relocalize, now_ns: int = 0) -> str:
    """Why a command was refused; empty: it was not."""
    instructions = coordinator.handle(CommandArrived(command), now_ns)
    (answer,) = (one for one in instructions if isinstance(one, AnswerCommand))
    return answer.done.problem


def given(command_id: str, **fields: object) -> SetPose:
    return msgspec.convert(
        {"schema": "set_pose/1", "sender": "client", "command_id": command_id, **fields}, SetPose
    )


def odometry(stamp_ns: int, x_m: float) -> OdometryArrived:
    pose = (x_m, 0.0, 0.0)
    return OdometryArrived(
        OdometryReading(sender="bridge", stamp_ns=stamp_ns, odom_from_robot=pose)
    )


def searched_everywhere(story: Story) -> None:
    story.scan(0, at_s=0.0)
    places = {NORTH: 0.5, SOUTH: 0.5}
    story.report(searched("s0.0", 0, places, epoch=story.epochs["s0.0"]), at_s=0.1)


def test_a_pose_given_before_the_first_scan_is_applied_after_it() -> None:
    story = Story("a")
    early = given("1", pose=(1.0, 2.0, 0.5))
    assert commanded(story.coordinator, early) == ""
    assert story.beliefs == []
    searched_everywhere(story)
    best = story.beliefs[0].hypotheses[0]
    assert (best.pose, best.covariance[0]) == ((1.0, 2.0, 0.5), 0.25)
    assert best.probability == pytest.approx(0.95)
    assert not story.beliefs[0].searching
    assert commanded(story.coordinator, early) == ""
    assert len(story.beliefs) == 1


def test_odometry_since_a_pose_given_before_the_first_scan_is_added() -> None:
    story = Story("a")
    story.coordinator.handle(odometry(-40 * SECOND, -8.0), 0)
    commanded(story.coordinator, given("1", pose=(1.0, 2.0, 0.0)))
    for second in range(40, 0, -1):
        story.coordinator.handle(odometry(-second * SECOND, -second / 5), 0)
    searched_everywhere(story)  # at odometry 0
    best = story.beliefs[0].hypotheses[0]
    assert best.pose == pytest.approx((9.0, 2.0, 0.0))
    assert best.covariance[0] > 0.25, "and it errs"


def test_only_the_last_command_before_the_first_scan_is_carried_out() -> None:
    story = Story("a")
    commanded(story.coordinator, given("1", pose=(1.0, 2.0, 0.5)))
    commanded(story.coordinator, given("2", pose=(3.0, 2.0, 0.5)))
    assert commanded(story.coordinator, Relocalize(sender="client", command_id="3")) == ""
    searched_everywhere(story)
    assert [place.probability for place in story.beliefs[0].hypotheses] == [0.5, 0.5]


def test_to_relocalize_in_the_first_step_begins_another_search_after_it() -> None:
    story = Story("a")
    story.scan(0, at_s=0.0)
    assert commanded(story.coordinator, Relocalize(sender="client", command_id="1")) == ""
    places = {NORTH: 0.5, SOUTH: 0.5}
    story.report(searched("s0.0", 0, places, epoch=story.epochs["s0.0"]), at_s=0.1)
    assert (story.beliefs[0].hypotheses, story.beliefs[0].searching) == ((), True)
    assert "s1.0" in story.epochs


def test_an_unknown_region_is_refused() -> None:
    story = Story("a")
    searched_everywhere(story)
    unknown = Relocalize(sender="client", command_id="1", region="attic")
    problem = commanded(story.coordinator, unknown)
    assert problem == "unknown region 'attic'; search.regions names none"
    assert len(story.beliefs[-1].hypotheses) == 2, "and nothing is forgotten"


def test_the_last_pose_is_not_used_after_relocalize() -> None:
    earlier = Story("a")
    earlier.follow(earlier.coordinator.handle(ScanArrived(scan(0, live=True)), 0))
    found = searched("s0.0", 0, {(9.0, 9.0, 0.0): 0.9}, epoch=earlier.epochs["s0.0"])
    earlier.report(found, at_s=0.1)
    for commands, causes in (
        ((), {"first search", "prior pose"}),
        ((Relocalize(sender="client", command_id="1"),), {"first search"}),
    ):
        story = Story(kept=earlier.checkpoints[-1])
        for command in commands:
            story.follow(story.coordinator.handle(CommandArrived(command), 0))
        story.follow(story.coordinator.handle(WorkerJoined("a"), 0))
        story.follow(story.coordinator.handle(ScanArrived(scan(0, live=True)), 0))
        places = {NORTH: 0.5, SOUTH: 0.5}
        story.report(searched("s0.0", 0, places, epoch=story.epochs["s0.0"]), at_s=0.1)
        began = [e.event for e in story.coordinator.events().events if isinstance(e.event, Began)]
        assert {event.cause for event in began} == causes


def test_a_successor_receives_commands_from_before_the_first_scan() -> None:
    story = Story("a")
    command = given("1", pose=(1.0, 2.0, 0.5))
    instructions = story.coordinator.handle(CommandArrived(command), 0)
    (published,) = [one for one in instructions if isinstance(one, PublishCheckpoint)]
    heir = Story(known=published.checkpoint)
    heir.follow(heir.coordinator.handle(WorkerJoined("a"), 0))
    searched_everywhere(heir)
    assert heir.beliefs[0].hypotheses[0].pose == (1.0, 2.0, 0.5)


def test_a_given_covariance_is_the_hypothesis_covariance() -> None:
    story = Story("a", "b").bootstrapped()
    covariance = (0.5, 0.1, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.02)
    command = given("1", pose=(1.0, 2.0, 0.5), covariance=covariance)
    story.follow(story.coordinator.handle(CommandArrived(command), SECOND))
    best = story.beliefs[-1].hypotheses[0]
    assert (best.pose, best.covariance) == ((1.0, 2.0, 0.5), covariance)


OFF_THE_MAP = (700.0, 0.5, 1.6)


def test_a_pose_off_the_map_is_refused_with_the_reason() -> None:
    story = Story("a").bootstrapped()
    reported = len(story.beliefs)
    problem = commanded(story.coordinator, given("1", pose=OFF_THE_MAP))
    assert problem.startswith("the map has no free ground within 3 sigma (0.50 m each) of x 700")
    assert len(story.beliefs) == reported
    assert commanded(story.coordinator, given("2", pose=(100.5, 0.5, 1.6))) == ""


def test_a_waiting_pose_off_the_map_is_refused_when_the_map_arrives() -> None:
    story = Story("a")
    early = given("1", pose=OFF_THE_MAP)
    assert commanded(story.coordinator, early) == "", "nobody knows the map yet"
    searched_everywhere(story)
    assert [place.probability for place in story.beliefs[0].hypotheses] == [0.5, 0.5]
    assert "no free ground" in commanded(story.coordinator, early)
    assert story.coordinator.status(SECOND, {}).counters["pose off the map refused"] == 1


def test_a_pose_waits_for_the_map_and_is_applied_when_the_map_arrives() -> None:
    story = Story("a")
    story.has_map = False
    searched_everywhere(story)
    assert commanded(story.coordinator, given("1", pose=(1.0, 2.0, 0.5))) == ""
    assert len(story.beliefs) == 1
    story.has_map = True
    story.follow(story.coordinator.handle(TimePassed(), 3 * SECOND))
    assert story.beliefs[-1].hypotheses[0].pose == (1.0, 2.0, 0.5)


def test_a_given_pose_waits_until_a_new_map_arrives() -> None:
    story = tracking_story(CoordinatorSettings(keep_pose_on_new_map=True))
    story.has_map = False
    in_a_new_map(story, 5, 6, 7)
    reported = len(story.beliefs)
    commanded(story.coordinator, given("1", pose=(1.0, 2.0, 0.5)))
    assert len(story.beliefs) == reported


def test_a_pose_with_an_older_stamp_is_moved_by_odometry() -> None:
    story = Story("a", "b").bootstrapped()
    for tenth in range(1, 21):  # a metre a second since the step, which was at 0
        story.coordinator.handle(odometry(tenth * SECOND // 10, tenth / 10), tenth)
    then = given("1", pose=(1.0, 2.0, 0.0), stamp_ns=5 * SECOND // 10)
    story.follow(story.coordinator.handle(CommandArrived(then), SECOND))
    assert story.coordinator.pose(SECOND).pose == pytest.approx((2.5, 2.0, 0.0))
    now = given("2", pose=(1.0, 2.0, 0.0))
    story.follow(story.coordinator.handle(CommandArrived(now), SECOND))
    assert story.coordinator.pose(SECOND).pose == pytest.approx((1.0, 2.0, 0.0))


def test_a_pose_older_than_the_known_odometry_is_refused_with_the_reason() -> None:
    story = Story("a", "b").bootstrapped()
    for tenth in range(1, 201):
        story.coordinator.handle(odometry(tenth * SECOND // 10, 0.01 * tenth), tenth)
    command = given("1", pose=(1.0, 2.0, 0.0), stamp_ns=2 * SECOND)
    before = len(story.beliefs)
    for _ in range(2):
        problem = commanded(story.coordinator, command)
        assert problem.startswith("the pose is of 13.0 s before the oldest odometry")
    assert len(story.beliefs) == before


def test_a_lost_link_stops_decisions_and_restarts_deadlines() -> None:
    story = Story("a", "b").bootstrapped()
    for step in range(1, 4):
        story.tracks(step, at_s=float(step), north=0.1, south=0.1)
    story.tracks(4, at_s=10.0, north=0.3, south=None)
    story.coordinator.handle(LinkChanged(up=False), 0)
    story.follow(story.coordinator.handle(TimePassed(), int(15 * SECOND)))
    assert story.beliefs[-1].step == 3
    story.follow(story.coordinator.handle(LinkChanged(up=True), int(16 * SECOND)))
    assert story.beliefs[-1].step == 3
    story.report(tracked("c1", 4, 0.1, SOUTH, epoch=story.epochs["c1"]), at_s=16.1)
    assert story.beliefs[-1].missing == ()
    assert [h.probability for h in story.beliefs[-1].hypotheses] == pytest.approx([0.75, 0.25])


def test_an_unchanged_state_is_published_again_as_a_sign_of_life() -> None:
    story = Story("a")
    story.scan(0, at_s=1.0)
    newest = story.checkpoints[-1]
    assert [one.serial for one in story.checkpoints] == list(range(len(story.checkpoints)))
    due_ns = SECOND + SIGN_OF_LIFE_NS
    assert story.coordinator.handle(TimePassed(), due_ns - 1) == []
    assert story.coordinator.handle(TimePassed(), due_ns) == [PublishCheckpoint(newest)]
    assert story.coordinator.handle(TimePassed(), due_ns + 1) == []
