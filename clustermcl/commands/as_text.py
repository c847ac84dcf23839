"""Converts messages to lines of text."""

import math
import time
from collections.abc import Iterable, Iterator
from itertools import groupby

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, Hypotheses, Hypothesis, PoseAnswer, Status
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import printable
from clustermcl.protocol.health import Health
from clustermcl.protocol.job_events import NumberedEvent, event_text
from clustermcl.protocol.message import Covariance, PoseTuple, ellipse_axes
from clustermcl.protocol.why import why_text

SILENT_AFTER_S = 3.0
"""A process counts as silent if its health, published every second, is older than this [s]."""
OFF_MAP = 0.5
"""Probability of off the map above which the text contains a warning."""
CLOCK_SET_NS = 1_000_000_000_000_000_000
"""A later stamp is a date after 2001 [ns]."""
NEARLY_OVER = 0.95
"""Progress of a search that waits for scans rather than for computing."""
LEAST_SHOWN = 0.01
"""Probability below which a place is counted, but not shown."""
DOUBT = 0.01
"""Probability of elsewhere above which the text mentions it."""


def pose_text(pose: PoseTuple, floor: str = "") -> str:
    """Return ``x 1.23 m  y -4.50 m  heading 90.0 deg``, after the floor if there are several."""
    x, y, heading = pose
    on = f"floor {printable(floor)}  " if floor else ""
    return f"{on}x {x:.2f} m  y {y:.2f} m  heading {math.degrees(heading):.1f} deg"


def place_text(pose: PoseTuple, covariance: Covariance, floor: str = "") -> str:
    """Return a pose and its standard deviations, as in ``x 1.23 m ...  +-0.06 m, 3.6 deg``.

    The first is the largest one of the position, the second that of the heading.
    """
    longer_m, _, _ = ellipse_axes(covariance[0], covariance[1], covariance[4])
    heading_deg = math.degrees(math.sqrt(max(covariance[8], 0.0)))
    return f"{pose_text(pose, floor)}  +-{longer_m:.2f} m, {heading_deg:.1f} deg"


def pose_lines(answer: PoseAnswer) -> Iterator[str]:
    """Yield the robot's pose as text, and the reasons to doubt the pose."""
    if answer.freshness == "none":
        yield f"{answer.state}: no scan has arrived yet"
    elif answer.pose is None or answer.covariance is None:
        yield f"{answer.state}: no place is known yet (step {answer.step})"
    else:
        yield (
            f"{answer.state} with probability {answer.probability:.2f}: "
            f"{place_text(answer.pose, answer.covariance, answer.floor)}"
        )
        yield from _floors(answer)
    yield from _doubts(answer)
    if answer.pose is not None and answer.elsewhere_probability > DOUBT:
        yield f"it may be elsewhere, with probability {answer.elsewhere_probability:.2f}"
    yield from _off_map(answer)
    if answer.workers == 0:
        yield "no worker is alive: the belief does not follow the robot"


def hypotheses_lines(answer: Hypotheses, *, why: bool = False) -> Iterator[str]:
    """Yield all places as text, or the pose's text if no place is known.

    `why`: what the last step changed is added.
    """
    if not answer.hypotheses:
        yield from pose_lines(answer.pose)
        return
    yield f"{answer.pose.state} at step {answer.pose.step}"
    for index, place in enumerate(answer.hypotheses):
        yield f"  {place.probability:6.3f}  {place_text(place.pose, place.covariance, place.floor)}"
        if why and (reasons := why_text(answer.why, index)):
            yield f"          place {place.cluster}: {reasons}"
    yield f"  {answer.pose.elsewhere_probability:6.3f}  elsewhere"
    yield from _floors(answer.pose)
    yield from _off_map(answer.pose)
    yield from _doubts(answer.pose)


def advice_lines(answer: Advice) -> Iterator[str]:
    """Yield the ways as text, best first, or the reason why there is none."""
    if answer.step >= 0:
        count = len(answer.clusters)
        yield f"{count} place{'' if count == 1 else 's'} at step {answer.step}"
    for number, way in enumerate(answer.ways, 1):
        x_m, y_m, _ = (*way.poses, *way.rest)[-1]
        bearing = math.degrees(math.atan2(y_m, x_m))
        where = f"to {math.hypot(x_m, y_m):.1f} m at {bearing:.0f} deg" if way.length_m else "turn"
        yield (
            f"  {number}. {where}, {way.length_m:.1f} m of way: {way.information:.2f} nat, "
            f"localized then with probability {way.sure_probability:.2f}"
        )
        if way.rest:
            yield f"     ask again at {math.hypot(*way.poses[-1][:2]):.1f} m"
    if answer.note:
        yield answer.note


def _off_map(answer: PoseAnswer) -> Iterator[str]:
    if answer.off_map_probability > OFF_MAP:
        yield f"probably not on this map ({answer.off_map_probability:.2f})"


def _floors(answer: PoseAnswer) -> Iterator[str]:
    probable = [(p, printable(name)) for name, p in answer.floors.items() if p >= LEAST_SHOWN]
    if len(probable) > 1:
        yield f"floors: {', '.join(f'{name} {p:.2f}' for p, name in sorted(probable)[::-1])}"


def _doubts(answer: PoseAnswer) -> Iterator[str]:
    match answer.freshness:
        case "stale":
            yield f"stale: the newest data is {answer.age_s:.1f} s old"
        case "dead_reckoning":
            yield f"dead reckoning: odometry alone moves the pose, {_last_scan(answer.scan_age_s)}"


def _last_scan(scan_age_s: float) -> str:
    return f"the last scan is {scan_age_s:.1f} s old" if scan_age_s >= 0.0 else "no scan yet"


def search_text(progress: float, *, runs: bool) -> str:
    """Return such as ``, a search runs 50 %``; the progress from 0 to 1 alone, or nothing."""
    reached = f" {100.0 * progress:.0f} %" if progress > 0.0 else ""
    reached += ", the next scans decide" if progress > NEARLY_OVER else ""
    return f"{', a search runs' if runs else ''}{reached}"


def belief_line(belief: Belief) -> str:
    """Return a belief as one line: its state, its best pose, and its largest probabilities."""
    runs = belief.searching and belief.state != "searching"
    search = search_text(belief.search_progress, runs=runs)
    note = ", dead reckoning" if is_unweighed(belief) else ""
    head = f"step {belief.step}: {belief.state}{search}{note}"
    if not belief.hypotheses:
        return head
    best = belief.hypotheses[0]
    shown = shown_places(belief)[:6]
    probabilities = ", ".join(f"{place.probability:.2f}" for place in shown)
    more = f", {count} more" if (count := len(belief.hypotheses) - len(shown)) else ""
    elsewhere = f", elsewhere {belief.elsewhere_probability:.2f}"
    if belief.off_map_probability > OFF_MAP:
        elsewhere += ", probably not on this map"
    place = pose_text(best.pose, best.floor)
    return f"{head}; best {place}; probabilities {probabilities}{more}{elsewhere}"


def shown_places(belief: Belief) -> tuple[Hypothesis, ...]:
    """Return the places above `LEAST_SHOWN`, and the most probable one."""
    places = belief.hypotheses
    return (*places[:1], *(place for place in places[1:] if place.probability >= LEAST_SHOWN))


def is_unweighed(belief: Belief) -> bool:
    """Return whether all places are dead reckoning: no worker weighed any of them in the step."""
    jobs = {f"c{hypothesis.cluster}" for hypothesis in belief.hypotheses}
    return bool(jobs) and jobs <= set(belief.missing)


def event_line(numbered: NumberedEvent) -> str:
    """Return an event as text, such as ``11:45:51 step 200: place 3 merged into place 1 (2.0 %)``.

    The time is that of the robot's clock, in local time, if it is a date and no count from 0.
    """
    clock = ""
    if numbered.stamp_ns > CLOCK_SET_NS:
        clock = time.strftime("%H:%M:%S ", time.localtime(numbered.stamp_ns // 1_000_000_000))
    return f"{clock}step {numbered.step}: {event_text(numbered.event)}"


def event_lines(events: Iterable[NumberedEvent]) -> Iterator[str]:
    """Yield events as text; what each shard of a search repeats is one line."""
    return (line for line, _ in groupby(map(event_line, events)))


def status_lines(status: Status) -> Iterator[str]:
    age = f", newest data {status.age_s:.1f} s old" if status.age_s >= 0.0 else ""
    search = search_text(status.search_progress, runs=status.searching)
    scan = f", {_last_scan(status.scan_age_s)}" if status.freshness == "dead_reckoning" else ""
    yield f"state     {status.state}, {status.freshness.replace('_', ' ')}{age}{scan}"
    yield (
        f"steps     at {status.step}, {status.steps_applied} applied, {status.steps_lost} lost, "
        f"{status.reports_missing} reports missing"
    )
    if status.overloaded:
        yield "          overloaded: steps wait, so scans are dropped and searches postponed"
    yield f"clusters  {status.clusters}{search}"
    yield f"map       {status.map_digest[:12] or 'not known yet'}"
    yield f"running   {status.uptime_s:.0f} s, version {status.version}"
    yield f"workers   {len(status.workers)}"
    for name, jobs in status.workers.items():
        yield f"  {name}: {' '.join(jobs) or 'idle'}"
    if status.processes:
        yield "processes"
        for process in status.processes:
            yield from (f"  {line}" for line in _process_lines(process))


def _process_lines(process: Health) -> Iterator[str]:
    memory = f", {process.memory_bytes / 1e6:.0f} MB" if process.memory_bytes else ""
    silent = f", silent for {process.age_s:.0f} s" if process.age_s > SILENT_AFTER_S else ""
    yield (
        f"{process.sender} ({process.role}) {process.version}, "
        f"up {process.uptime_s:.0f} s{memory}{silent}"
    )
    for what, rate in sorted(process.rates_per_s.items()):
        age_s = process.ages_s.get(what, 0.0) + process.age_s
        yield f"  {what}: {process.done.get(what, 0)}, {rate:.1f}/s, last {age_s:.1f} s ago"
    for what, value in process.gauges.items():
        yield f"  {what}: {value:.2f}"
    for cause, count in sorted(process.dropped.items()):
        means = next((f" ({known.means})" for known in Cause if known == cause), "")
        yield f"  dropped or refused: {cause}: {count}{means}"
    for source in process.sources:
        yield f"  source {source.name}: {source.outlier_rate:.0%} of its observations are false"
