from typing import Any

import pytest
from msgspec.structs import replace

from clustermcl.coordinator import events
from clustermcl.coordinator import instructions as do
from clustermcl.coordinator.coordinator import SIGN_OF_LIFE_NS, STEPS_AT_ONCE
from clustermcl.coordinator.event_log import HANDED_ON_EVENTS, KEPT_EVENTS, EventLog
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.answers import Belief, CommandDone, Hypothesis, Relocalize, SetPose, Status
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.floors import Floor, Floors
from clustermcl.protocol.job_events import Began, Ended, JobEvents, Remark
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import OdometryReading
from clustermcl.protocol.work import Checkpoint, OrderAnswer, Report, SearchJob, WorkerState
from clustermcl.runtime.settings import CoordinatorSettings
from tests.unit.coordinator.reports import (
    NO_SPREAD,
    free_everywhere,
    literal_bayes,
    scan,
    searched,
    started,
    tracked,
)

SECOND = 1_000_000_000
NORTH, SOUTH = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0)
BOTH: dict[PoseTuple, float] = {NORTH: 0.5, SOUTH: 0.5}
FORGET = Relocalize(sender="client", command_id="forget")


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
        self.coordinator = started(
            filter_settings=settings, settings=rules, known=known, kept=kept
        ).coordinator()
        self.has_map = True
        self.frozen: set[str] = set()
        """Workers that receive nothing."""
        self.checkpoints: list[Checkpoint] = []
        self.epochs: dict[str, int] = {}
        self.places: dict[str, str] = {}
        self.beliefs: list[Belief] = []
        self.reported: list[Belief | JobEvents] = []
        for worker in workers:
            self.handle(events.WorkerChanged(worker, "joined"))

    def handle(self, event: events.Event, at_s: float = 0.0) -> list[do.Instruction]:
        instructions = self.coordinator.handle(event, int(at_s * SECOND))
        self.follow(instructions)
        return instructions

    def follow(self, instructions: list[do.Instruction]) -> None:
        for instruction in instructions:
            match instruction:
                case Belief():
                    self.beliefs.append(decode(encode(instruction), Belief))
                    self.reported.append(instruction)
                case Checkpoint():
                    self.checkpoints.append(instruction)
                case JobEvents():
                    self.reported.append(decode(encode(instruction), JobEvents))
                case do.FetchMap() if self.has_map:
                    self.handle(
                        events.MapArrived(free_everywhere(self.coordinator.state.map_digest))
                    )
                case do.FetchScans(last=last) if last is not None:
                    self.handle(events.HistoryArrived(()))
                case do.AskState(worker=worker):
                    state = WorkerState(sender=worker, term=0, holds=())
                    self.handle(events.WorkerStateArrived(worker, state))
                case do.SendOrder(worker=worker, order=order) if worker not in self.frozen:
                    for assignment in order.begin:
                        self.epochs[assignment.job_id] = assignment.epoch
                        self.places[assignment.job_id] = worker
                    jobs = (*order.keep, *((a.job_id, a.epoch) for a in order.begin))
                    answer = OrderAnswer(
                        sender=worker, order=order.order,
                        jobs=tuple((job_id, epoch, 0) for job_id, epoch in jobs),
                    )  # fmt: skip
                    self.coordinator.handle(events.OrderAnswered(worker, answer), 0)

    def scan(self, step: int, *, at_s: float | None = None, **shown: Any) -> list[do.Instruction]:
        return self.handle(events.ScanArrived(scan(step, **shown)), step if at_s is None else at_s)

    def report(self, report: Report, *, at_s: float) -> None:
        report = replace(report, epoch=self.epochs[report.job_id])
        self.handle(events.ReportArrived(self.places[report.job_id], report), at_s)

    def finds(self, places: dict[PoseTuple, float], *, job_id: str = "s0.0", step: int = 0) -> None:
        self.report(searched(job_id, step, places), at_s=step + 0.1)

    def bootstrapped(self) -> "Story":
        self.scan(0)
        self.finds(BOTH)
        return self

    def tracks(
        self, step: int, *, north: float, south: float | None, at_s: float | None = None
    ) -> None:
        at_s = step if at_s is None else at_s
        self.scan(step, at_s=at_s)
        self.report(tracked("c0", step, north, NORTH), at_s=at_s + 0.01)
        if south is not None:
            self.report(tracked("c1", step, south, SOUTH), at_s=at_s + 0.02)

    def command(self, command: SetPose | Relocalize, at_s: float = 0.0) -> str:
        """Why it was refused; empty: it was not."""
        instructions = self.handle(events.CommandArrived(command), at_s)
        (answer,) = (one for one in instructions if isinstance(one, CommandDone))
        return answer.problem

    def tick(self, *, at_s: float) -> None:
        self.handle(events.TimePassed(), at_s)

    def odometry(self, stamp_s: float, x_m: float, at_s: float = 0.0) -> None:
        reading = OdometryReading(
            sender="bridge", stamp_ns=round(stamp_s * SECOND), odom_from_robot=(x_m, 0.0, 0.0)
        )
        self.handle(events.OdometryArrived(reading), at_s)

    @property
    def best(self) -> Hypothesis:
        return self.beliefs[-1].hypotheses[0]

    @property
    def probabilities(self) -> list[float]:
        return [place.probability for place in self.beliefs[-1].hypotheses]

    def status(self, at_s: float = 0.0) -> Status:
        return self.coordinator.status(int(at_s * SECOND), {})

    def ended(self) -> dict[str, str]:
        found = [one.event for one in self.coordinator.events().events]
        return {event.job_id: event.cause for event in found if isinstance(event, Ended)}


def checkpoint_at(place: PoseTuple, *, live: bool = True, x_m: float = 0.0) -> Checkpoint:
    """Of one that is nearly sure of a place, and was there at odometry `x_m`."""
    story = Story("a")
    story.scan(0, live=live, x_m=x_m)
    story.finds({place: 0.9, (1.0, 1.0, 0.0): 0.1})
    return replace(story.checkpoints[-1], term=7)


def given(command_id: str, *pose: float, **fields: Any) -> SetPose:
    return SetPose(sender="client", command_id=command_id, pose=pose, **fields)  # type: ignore[arg-type] # three numbers


def test_a_worker_cannot_report_another_workers_job() -> None:
    story = Story("a", "b").bootstrapped()
    story.scan(1)
    forger = story.places["c0"]
    assert forger != story.places["c1"]
    forged = tracked("c1", 1, 1e9, SOUTH, epoch=story.epochs["c1"])
    story.handle(events.ReportArrived(forger, forged), 1.0)
    story.report(tracked("c1", 1, 0.1, SOUTH), at_s=1.1)
    story.report(tracked("c0", 1, 0.1, NORTH), at_s=1.1)
    assert story.probabilities == pytest.approx([0.5, 0.5])
    assert story.status().counters["report of another worker's job"] == 1


def test_events_are_published_before_their_belief_and_can_be_queried_afterwards() -> None:
    story = Story("a").bootstrapped()
    first, belief = story.reported
    assert belief == story.beliefs[0]
    assert [(one.number, one.step, one.stamp_ns, one.event) for one in first.events] == [
        (0, 0, 0, Began("c0", "first search", pytest.approx(0.5))),
        (1, 0, 0, Began("c1", "first search", pytest.approx(0.5))),
        (2, 0, 0, Ended("s0.0", "search over")),
    ]
    story.tracks(1, north=0.3, south=0.1)
    assert story.reported[2:] == story.beliefs[1:], "nothing began or ended"
    story.command(FORGET, 2.0)
    forgotten = story.reported[3]
    assert forgotten.term == first.term == story.coordinator.pose(SECOND).term
    assert [one.event for one in forgotten.events] == [
        Remark(cause="search requested", detail="by client"),
        Ended("c0", "forgotten", (), pytest.approx(0.75)),
        Ended("c1", "forgotten", (), pytest.approx(0.25)),
    ]
    story.command(given("1", 1.0, 2.0, 0.5), 3.0)
    everything = (*first.events, *forgotten.events, *story.reported[5].events)
    assert story.coordinator.events().events == everything
    heir = Story("a", known=story.checkpoints[-1])
    assert heir.coordinator.events().events == everything
    heir.command(given("2", 5.0, 2.0, 0.5), 4.0)
    assert heir.reported[1].events[0].number == len(everything)


def test_commands_and_faults_of_sensors_are_events() -> None:
    story, silent = Story("a").bootstrapped(), Remark(cause="laser silent", detail="for 3.1 s")
    story.scan(1, remarks=(silent,))
    for job_id, place in (("c0", NORTH), ("c1", SOUTH)):
        story.report(tracked(job_id, 1, 0.1, place), at_s=1.1)
    problem = story.command(Relocalize(sender="page", command_id="1", floor="lab"))
    assert problem
    story.command(given("2", 1.0, 2.0, 0.5), 2.0)
    remarks = [one for one in story.coordinator.events().events if isinstance(one.event, Remark)]
    assert [(one.step, one.event.cause, one.event.detail) for one in remarks] == [
        (1, "laser silent", "for 3.1 s"),
        (1, "search requested", f"floor lab, by page, refused: {problem}"),
        (1, "pose given", "x 1.00 m  y 2.00 m  heading 28.6 deg  +-0.50 m, by client"),
    ]


def tracking_story(rules: CoordinatorSettings = CoordinatorSettings()) -> Story:  # noqa: B008 - frozen
    story = Story("a", rules=rules).bootstrapped()
    for step in range(1, 5):
        story.tracks(step, north=0.1, south=0.1)
    return story


def test_clusters_end_with_the_cause_when_the_bridge_restarts_its_steps() -> None:
    story = tracking_story()
    for step in range(3):
        again = replace(scan(step), stamp_ns=(20 + step) * SECOND)
        story.handle(events.ScanArrived(again), 20 + step)
    assert story.ended() == {
        "s0.0": "search over", "c0": "steps restarted", "c1": "steps restarted"
    }  # fmt: skip


def test_a_bridge_with_another_map_begins_a_search_in_that_map() -> None:
    story = tracking_story()
    instructions: list[do.Instruction] = []
    for step in range(5, 8):
        assert story.coordinator.state.map_digest == "map"
        assert instructions == [], "these may be stray"
        instructions += story.scan(step, digest="new map")
    assert story.coordinator.state.map_digest == "new map"
    (order,) = [one.order for one in instructions if isinstance(one, do.SendOrder)]
    assert order.map_digest == "new map"
    assert order.keep == ()
    assert {one.job.first_step for one in order.begin if isinstance(one.job, SearchJob)} == {7}
    status = story.status(8.0)
    assert status.map_digest == "new map"
    assert status.counters == {"map changed": 1, "scan of another map": 2}
    assert (status.state, status.clusters) == ("searching", 0)
    assert story.ended().items() >= {"c0": "new map", "c1": "new map"}.items()
    story.finds({NORTH: 1.0}, job_id="s1.0", step=7)
    assert (story.beliefs[-1].step, story.beliefs[-1].state) == (7, "localized")


def in_a_new_map(*, has_map: bool = True) -> Story:
    """Of a robot that has driven on by 1.7 m since the last step in the old map."""
    story = tracking_story(CoordinatorSettings(keep_pose_on_new_map=True))
    story.has_map = has_map
    for step in (5, 6, 7):
        story.scan(step, x_m=1.0 + 0.1 * step, digest="new map")
    return story


def test_places_are_kept_in_a_new_map_if_so_configured_and_moved_by_odometry() -> None:
    story = in_a_new_map()
    pose = story.coordinator.hypotheses(7 * SECOND)
    north, south = sorted(pose.hypotheses, key=lambda place: -place.pose[1])
    assert north.pose == pytest.approx((1.7, 5.0, 0.0))
    assert south.pose == pytest.approx((1.7, -5.0, 0.0))
    assert min(north.covariance[0], south.covariance[0]) > NO_SPREAD[0]
    status = story.status(7.0)
    assert (status.map_digest, status.clusters, status.searching) == ("new map", 2, False)
    for job_id, place in (("c2", NORTH), ("c3", SOUTH)):
        story.report(tracked(job_id, 7, 0.1, place), at_s=7.1)
    assert (story.beliefs[-1].step, story.beliefs[-1].state) == (7, "ambiguous")
    assert story.probabilities == pytest.approx([0.5, 0.5])
    causes = [e.event.cause for e in story.coordinator.events().events]
    assert (causes.count("new map"), causes.count("prior pose")) == (2, 2)


@pytest.mark.parametrize(("renamed", "kept"), [("down", True), ("cellar", False)])
def test_places_keep_their_floor_in_a_new_map(renamed: str, kept: bool) -> None:
    """The floors lie elsewhere in the new atlas; if they have other names, it is searched again."""
    up, down = (
        Floor("up", (0, 0), (-50, 0), (50, 50)),
        Floor("down", (0, -40), (-50, -50), (50, -1)),
    )
    moved = Floor(renamed, (300, -40), (250, -50), (350, -1))
    story = tracking_story(CoordinatorSettings(keep_pose_on_new_map=True))
    story.scan(5, floors=Floors((up, down)))
    for job_id, place in (("c0", NORTH), ("c1", SOUTH)):
        story.report(tracked(job_id, 5, 0.1, place), at_s=5.1)
    for step in (6, 7, 8):
        story.scan(step, digest="new map", floors=Floors((up, moved)))
    assert story.status(8.0).clusters == (2 if kept else 0)
    if kept:
        found = story.coordinator.hypotheses(8 * SECOND).hypotheses
        at = {place.floor: place.pose for place in found}
        assert at == {"up": pytest.approx(NORTH), "down": pytest.approx((SOUTH[0], 35.0, SOUTH[2]))}


def test_a_step_that_no_worker_weighed_makes_the_pose_dead_reckoning() -> None:
    story = tracking_story()
    for step in range(5, 12):
        story.scan(step, x_m=0.2 * (step - 4))
        story.tick(at_s=step + 0.9)
    pose = story.coordinator.pose(12 * SECOND)
    assert (pose.step, pose.freshness) == (11, "dead_reckoning")
    assert pose.scan_age_s == 8.0
    assert story.best.covariance[0] > 1.5 * story.beliefs[4].hypotheses[0].covariance[0]


def test_decisions_are_sent_in_between_if_many_steps_are_due() -> None:
    story = tracking_story()
    for step in range(5, 5 + 2 * STEPS_AT_ONCE + 1):
        story.scan(step, at_s=5.0)
    reported = []
    for _ in range(4):
        before = len(story.beliefs)
        story.tick(at_s=60.0)
        reported.append(len(story.beliefs) - before)
    assert reported == [STEPS_AT_ONCE, STEPS_AT_ONCE, 1, 0]


def test_a_pose_given_before_the_first_scan_is_applied_after_it_by_a_successor_too() -> None:
    story, early = Story("a"), given("1", 1.0, 2.0, 0.5)
    assert story.command(early) == ""
    assert story.beliefs == []
    heir = Story(known=story.checkpoints[-1])
    heir.handle(events.WorkerChanged("a", "joined"))
    for one in (story, heir):
        one.bootstrapped()
        assert (one.best.pose, one.best.covariance[0]) == ((1.0, 2.0, 0.5), 0.25)
        assert one.best.probability == 1.0, "elsewhere is impossible in this story"
        assert not one.beliefs[0].searching
        assert one.command(early) == ""
        assert len(one.beliefs) == 1


def test_odometry_since_a_pose_given_before_the_first_scan_is_added() -> None:
    story = Story("a")
    story.odometry(-40.0, -8.0)
    story.command(given("1", 1.0, 2.0, 0.0))
    for second in range(40, 0, -1):
        story.odometry(-second, -second / 5)
    story.bootstrapped()  # at odometry 0
    assert story.best.pose == pytest.approx((9.0, 2.0, 0.0))
    assert story.best.covariance[0] > 0.25, "and it errs"


def test_only_the_last_command_before_the_first_scan_is_carried_out() -> None:
    story = Story("a")
    story.command(given("1", 1.0, 2.0, 0.5))
    story.command(given("2", 3.0, 2.0, 0.5))
    assert story.command(FORGET) == ""
    assert story.bootstrapped().probabilities == [0.5, 0.5]
    assert story.command(replace(FORGET, command_id="3", floor="attic")).startswith(
        "there is no floor"
    )
    assert len(story.beliefs[-1].hypotheses) == 2, "and nothing is forgotten"


def test_to_relocalize_in_the_first_step_begins_another_search_after_it() -> None:
    story = Story("a")
    story.scan(0)
    assert story.command(FORGET) == ""
    story.finds(BOTH)
    assert (story.beliefs[0].hypotheses, story.beliefs[0].searching) == ((), True)
    assert "s1.0" in story.epochs


def test_the_last_pose_is_not_used_after_relocalize() -> None:
    earlier = Story("a")
    earlier.scan(0, live=True)
    earlier.finds({(9.0, 9.0, 0.0): 0.9})
    for commands, causes in (([], {"first search", "prior pose"}), ([FORGET], {"first search"})):
        story = Story(kept=earlier.checkpoints[-1])
        for command in commands:
            story.command(command)
        story.handle(events.WorkerChanged("a", "joined"))
        story.scan(0, live=True)
        story.finds(BOTH)
        began = [e.event for e in story.coordinator.events().events if isinstance(e.event, Began)]
        assert {event.cause for event in began} == causes


OFF_THE_MAP = (700.0, 0.5, 1.6)


def test_a_given_pose_is_the_hypothesis_unless_it_is_off_the_map() -> None:
    story = Story("a", "b").bootstrapped()
    reported = len(story.beliefs)
    problem = story.command(given("1", *OFF_THE_MAP))
    assert problem.startswith("the map has no free ground within 3 sigma (0.50 m each) of x 700")
    assert len(story.beliefs) == reported
    assert story.command(given("2", 100.5, 0.5, 1.6)) == ""
    covariance = (0.5, 0.1, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.02)
    story.command(given("3", 1.0, 2.0, 0.5, covariance=covariance), 1.0)
    assert (story.best.pose, story.best.covariance) == ((1.0, 2.0, 0.5), covariance)


def test_a_waiting_pose_off_the_map_is_refused_when_the_map_arrives() -> None:
    story, early = Story(), given("1", *OFF_THE_MAP)
    story.has_map = False
    story.handle(events.WorkerChanged("a", "joined"))
    assert story.command(early) == "", "nobody knows the map yet"
    story.has_map = True
    assert story.bootstrapped().probabilities == [0.5, 0.5]
    assert "no free ground" in story.command(early)
    assert story.status().counters["pose off the map refused"] == 1


def test_a_pose_before_the_first_scan_is_checked_with_the_bridges_map() -> None:
    story = Story()
    story.has_map = False
    asked = [one for at_s in (10.0, 20.0) for one in story.handle(events.TimePassed(), at_s)]
    assert any(isinstance(one, do.FetchMap) for one in asked)
    story.handle(events.MapArrived(free_everywhere("digest of the bridge")))
    assert story.status().map_digest == "digest of the bridge"
    assert "no free ground" in story.command(given("1", *OFF_THE_MAP))


def test_a_pose_waits_for_the_map_and_is_applied_when_the_map_arrives() -> None:
    story = Story("a")
    story.has_map = False
    story.bootstrapped()
    assert story.command(given("1", 1.0, 2.0, 0.5)) == ""
    assert len(story.beliefs) == 1
    story.has_map = True
    story.tick(at_s=3.0)
    assert story.best.pose == (1.0, 2.0, 0.5)
    story = in_a_new_map(has_map=False)
    reported = len(story.beliefs)
    story.command(given("1", 1.0, 2.0, 0.5))
    assert len(story.beliefs) == reported, "for a new map too"


def test_a_pose_with_an_older_stamp_is_moved_by_odometry() -> None:
    story = Story("a", "b").bootstrapped()
    for tenth in range(1, 21):  # a metre a second since the step, which was at 0
        story.odometry(tenth / 10, tenth / 10)
    story.command(given("1", 1.0, 2.0, 0.0, stamp_ns=SECOND // 2), 1.0)
    assert story.coordinator.pose(SECOND).pose == pytest.approx((2.5, 2.0, 0.0))
    story.command(given("2", 1.0, 2.0, 0.0), 1.0)
    assert story.coordinator.pose(SECOND).pose == pytest.approx((1.0, 2.0, 0.0))


def test_a_pose_older_than_the_known_odometry_is_refused_with_the_reason() -> None:
    story = Story("a", "b").bootstrapped()
    for tenth in range(1, 201):
        story.odometry(tenth / 10, 0.01 * tenth)
    before = len(story.beliefs)
    for _ in range(2):
        problem = story.command(given("1", 1.0, 2.0, 0.0, stamp_ns=2 * SECOND))
        assert problem.startswith("the pose is of 13.0 s before the oldest odometry")
    assert len(story.beliefs) == before


def test_only_reports_that_a_step_has_lacked_are_counted_as_missing() -> None:
    """A search may lag, and a new cluster reports on the scans since its search."""
    story = Story("a")
    story.scan(0)
    story.tick(at_s=30.0)
    assert story.beliefs[-1].missing == ("s0.0",)
    story.scan(1, at_s=31.0)
    story.report(searched("s0.0", 1, BOTH), at_s=31.1)
    for name, place in (("c0", NORTH), ("c1", SOUTH)):
        story.report(tracked(name, 1, 0.1, place), at_s=31.2)
    status = story.status(32.0)
    assert (status.clusters, status.reports_missing) == (2, 0)
    story.tracks(2, north=0.1, south=None, at_s=40.0)
    story.tick(at_s=70.0)
    status = story.status(72.0)
    assert (status.step, status.reports_missing) == (2, 1)


def test_a_lost_link_stops_decisions_and_restarts_deadlines() -> None:
    story = Story("a", "b").bootstrapped()
    for step in range(1, 4):
        story.tracks(step, north=0.1, south=0.1)
    story.tracks(4, at_s=10.0, north=0.3, south=None)
    story.handle(events.LinkChanged(up=False))
    story.tick(at_s=15.0)
    assert story.beliefs[-1].step == 3
    back = story.handle(events.LinkChanged(up=True), 16.0)
    ordered = [one.worker for one in back if isinstance(one, do.SendOrder)]
    assert ordered == ["a", "b"], "they repeat their reports"
    assert story.beliefs[-1].step == 3
    story.report(tracked("c1", 4, 0.1, SOUTH), at_s=16.1)
    assert story.beliefs[-1].missing == ()
    assert story.probabilities == pytest.approx([0.75, 0.25])


def test_a_scan_that_a_busy_bridge_sends_late_is_not_lost() -> None:
    story = Story("a").bootstrapped()
    decide = story.coordinator.handle
    last = story.beliefs[-1].step
    assert do.FetchScans(last + 1, last + 1) in decide(
        events.ScanArrived(scan(last + 2)), 10 * SECOND
    )
    waiting = decide(events.TimePassed(), 11 * SECOND)
    assert not any(isinstance(one, Belief) for one in waiting)
    story.handle(events.HistoryArrived((scan(last + 1),)), 11.1)
    story.tick(at_s=12.0)
    assert [belief.step for belief in story.beliefs[-2:]] == [last + 1, last + 2]


def test_an_unchanged_state_is_published_again_as_a_sign_of_life() -> None:
    story = Story("a")
    story.scan(0, at_s=1.0)
    newest = story.checkpoints[-1]
    assert [one.serial for one in story.checkpoints] == list(range(len(story.checkpoints)))
    due_ns = SECOND + SIGN_OF_LIFE_NS
    assert story.coordinator.handle(events.TimePassed(), due_ns - 1) == []
    assert story.coordinator.handle(events.TimePassed(), due_ns) == [newest]
    assert story.coordinator.handle(events.TimePassed(), due_ns + 1) == []


LIVE = LiveSettings(turn_noise_per_turn=0.4, hit_weight=0.5, gate_distance_m=0.7)


def goes_by(story: Story) -> tuple[float, float, float, float]:
    state = story.coordinator.state
    since = state.pose.since_step
    return (
        state.ensemble.settings.motion.turn_noise_per_turn,
        since.motion.turn_noise_per_turn,
        state.ensemble.clusters.settings.sensor.hit_weight,
        since.bridge.gate_distance_m,
    )


def test_the_settings_of_the_applied_scan_hold_and_a_successor_keeps_them() -> None:
    story = Story("a")
    story.scan(0)
    story.finds({NORTH: 1.0})
    started = goes_by(story)
    assert started != (0.4, 0.4, 0.5, 0.7)
    story.scan(1, settings=LIVE)
    story.report(tracked("c0", 1, 0.1, NORTH), at_s=1.1)
    heir = Story("a", known=story.checkpoints[-1])
    for one in (story, heir):
        assert goes_by(one) == (0.4, 0.4, 0.5, 0.7)
        assert one.status(2.0).settings == LIVE
    heir.scan(2)
    heir.tick(at_s=60.0)
    assert goes_by(heir) == started
    assert heir.coordinator.state.live == AS_STARTED


def test_the_last_events_are_kept_and_their_numbers_go_on() -> None:
    log = EventLog()
    for step in range(KEPT_EVENTS + 5):
        log.add([Ended(f"c{step}", "merged", ("c0",), 0.1)], step, step * 10)
    assert len(log.unpublished) == KEPT_EVENTS, "as before the first step"
    kept = tuple(log.kept)
    assert [event.number for event in kept] == list(range(5, KEPT_EVENTS + 5))
    assert kept[0].event == Ended("c5", "merged", ("c0",), 0.1)
    assert (kept[0].step, kept[0].stamp_ns) == (5, 50)
    heir = log.recent()
    assert (heir.kept, heir.count, heir.news()) == (log.kept[-HANDED_ON_EVENTS:], log.count, ())
