// Fills the panel next to the map.
import { BEAM_COLOURS } from "./beams.js";
import { onFloor } from "./floors.js";
import { whenReleased } from "./lists.js";
import { colourOf, fixed, isDashed, percent } from "./palette.js";

const $ = (id) => document.getElementById(id);

const STALE_AFTER_S = 3;
const OLD = { stale: "stale", dead_reckoning: "dead reckoning" }; // kinds of freshness
const PROBABLY = 0.5; // as `clustermcl pose` says it

let pose = null, poseAt = null; // time of arrival [ms]; null: a past or recorded pose
let before = ""; // age of a past step, in words
let step = null; // the shown one

export function showStep(frame) {
  step = frame;
  $("now").dataset.state = frame.state;
  showHeadline();
  $("searching").hidden = !frame.searching || (frame.state === "searching" && !frame.search_progress);
  $("searching").textContent = frame.search_progress > 0
    ? `searching ${Math.round(100 * frame.search_progress)} %` : "searching";
  $("step").textContent = frame.step;
  const best = frame.places[0];
  $("off-box").hidden = document.querySelector("[data-layer=truth]").hidden = !frame.truth;
  $("off").textContent = frame.truth && best
    ? `${Math.hypot(best.pose[0] - frame.truth[0], best.pose[1] - frame.truth[1]).toFixed(2)} m` : "–";
}

/** The state; of a pose that cannot be relied on, why it cannot, as `clustermcl pose` ends then. */
function showHeadline() {
  if (!step) return;
  const count = step.places.length, isKnown = ["localized", "searching"].includes(step.state);
  const state = isKnown || !count ? step.state : `${step.state}, ${count} place${count > 1 ? "s" : ""}`;
  const old = OLD[$("now").dataset.freshness], isOff = step.off_map > PROBABLY;
  $("state").textContent = old ?? state;
  $("of").textContent = old ? `last known: ${state}` : isOff ? "probably not on this map"
    : step.state !== "localized" && count > 1 ? `most probable of ${count}:` : "";
  $("of").hidden = !$("of").textContent;
}

/**
 * @param at time of arrival [ms]; null: a past or recorded pose
 * @param ago age of a past step, in words; empty: it is the newest
 */
export function showPose(frame, at, ago = "") {
  [pose, poseAt, before] = [frame, at, ago];
  const { x, y } = pose.pose ? onFloor(pose.pose) : {}, heading = pose.pose?.[2];
  const sigma = pose.covariance ? [0, 4, 8].map((at) => Math.sqrt(Math.max(pose.covariance[at], 0))) : [];
  const shown = (value, error, unit) => value === undefined ? ["–"]
    : [`${value}${unit}`, ...(error === undefined ? [] : [element("small", `± ${error}${unit}`)])];
  $("x").replaceChildren(...shown(fixed(x, 2), sigma[0]?.toFixed(2), " m"));
  $("y").replaceChildren(...shown(fixed(y, 2), sigma[1]?.toFixed(2), " m"));
  const degrees = (value) => fixed(value && value * 180 / Math.PI, 0);
  $("heading").replaceChildren(...shown(degrees(heading), degrees(sigma[2]), "°"));
  $("probability").textContent = pose.pose ? percent(pose.probability) : "–";
  showAge();
}

/** The age of the pose; of a past step, its age then. */
export function showAge() {
  if (!pose) return;
  const since = poseAt === null ? 0 : (performance.now() - poseAt) / 1000, age = pose.age_s + since;
  const isLate = pose.freshness === "fresh" && age > STALE_AFTER_S;
  const isRecorded = ["replaying", "finished"].includes(document.documentElement.dataset.link);
  const freshness = step?.last ? "ended" : isRecorded ? "recorded" : isLate ? "stale" : pose.freshness;
  $("now").dataset.freshness = freshness;
  showHeadline();
  const old = OLD[freshness], { state } = $("now").dataset;
  announce([old ? `${old}, last known: ${state}` : state, before && "looking back"].filter(Boolean).join(", "));
  $("freshness").textContent = before || {
    ended: "the run has ended",
    recorded: "recorded",
    none: "no scan yet",
    fresh: `${seconds(age)} old`,
    stale: `${seconds(age)} old`,
    dead_reckoning: !pose.workers ? "no worker is alive"
      : pose.scan_age_s < 0 ? "no scan was used yet" : `last scan ${seconds(pose.scan_age_s + since)} ago`,
  }[freshness];
}

/** Whether the pose is stale or by dead reckoning. */
export const isOld = () => $("now").dataset.freshness in OLD;

/** Announce a change of the state to screen readers. */
function announce(text) {
  if ($("announced").textContent !== text) $("announced").textContent = text;
}

/** The time of day by a robot's clock; of a simulated one, the time since its start. */
export function clock(stamp_s) {
  if (stamp_s > 1e9) return new Date(1000 * stamp_s).toLocaleTimeString("en-GB");
  return `${Math.floor(stamp_s / 60)}:${String(Math.floor(stamp_s % 60)).padStart(2, "0")}`;
}

export const seconds = (s) => `${s < 10 ? s.toFixed(1) : s.toFixed(0)} s`;

export const showClusters = (...shown) => whenReleased($("clusters"), () => fillClusters(...shown));

function fillClusters(places, view, elsewhere, offMap) {
  const focused = document.activeElement.closest("#clusters li")?.dataset.cluster;
  $("cluster-count").textContent = places.length || "";
  const rows = places.map((place) => {
    const row = element("li"), button = element("button", "", "row");
    row.style.setProperty("--chip", colourOf(place.slot));
    const { floor, x, y } = onFloor(place.pose), on = floor ? `, ${floor.name}` : "";
    row.title = `(${fixed(x, 2)}, ${fixed(y, 2)}) m${on}, ${place.age} steps old; click to show it and its beams${place.why && `
${place.why}`}`;
    row.dataset.cluster = place.cluster;
    row.append(button);
    button.append(chip(place.slot), `place ${place.cluster}${on}`, barOf(place.p), element("b", percent(place.p)));
    return row;
  });
  if (!places.length) rows.push(element("li", "no places yet", "more"));
  if (elsewhere != null) {
    const row = element("li", "", "elsewhere"), cells = element("span", "", "row");
    row.title = "probability that the robot is at none of these places";
    row.append(cells);
    cells.append(element("span"), element("span", "elsewhere"), barOf(elsewhere), element("b", percent(elsewhere)));
    if (offMap > 0.005) cells.append(element("span", `${percent(offMap)} not on this map`, "more"));
    rows.unshift(row); // visible also with many places
  }
  $("clusters").replaceChildren(...rows);
  if (focused) document.querySelector(`#clusters li[data-cluster="${focused}"] button`)?.focus({ preventScroll: true });
  markRows(view);
}

/** Mark the rows of the cluster under the pointer and of the selected one. */
export function markRows({ pointed, selected }) {
  for (const row of $("clusters").children) {
    row.classList.toggle("pointed", row.dataset.cluster === String(pointed));
    row.classList.toggle("selected", row.dataset.cluster === String(selected));
  }
}

/** Count the beams for and against the selected place. */
export function showBeams(cluster, counts) {
  $("beams").hidden = !counts;
  if (!counts) return;
  const words = ["hit", "through a wall", "short of one"].map((word, kind) => {
    const shown = element("b", `${counts[kind]} ${word}`);
    shown.style.color = `var(${BEAM_COLOURS[kind]})`;
    return shown;
  });
  $("beams").replaceChildren(`beams of place ${cluster}:`, ...words);
}

export function showEvents(events, slots, nothing = "no events yet") {
  const rows = events.toReversed().map(({ cluster, kind, stamp_s, step, text }) => {
    const slot = slots.get(cluster), row = element("li", "", kind);
    row.append(slot === undefined ? element("span") : chip(slot), element("time", clock(stamp_s)), element("span", text.replace(/\(.*\)$/, (p) => p.replaceAll(" ", "\u00a0"))));
    row.title = `step ${step}`;
    return row;
  });
  $("events").replaceChildren(...(rows.length ? rows : [element("li", nothing, "empty")]));
}

export function showWorkers(status) {
  const workers = Object.entries(status.workers), rounded = (value) => Number(value.toFixed(1));
  $("system").hidden = false;
  $("worker-count").textContent = workers.length || "none is alive";
  $("workers").replaceChildren(...workers.map(([name, itsJobs]) => {
    const jobs = element("span", "", "jobs"), row = element("li");
    for (const job of itsJobs) jobs.append(element("span", job, "job"));
    if (!itsJobs.length) jobs.append(element("span", "idle", "idle"));
    row.append(element("span", name), jobs);
    const health = status.processes.find((process) => process.sender === name);
    const rates = Object.entries(health?.rates_per_s ?? {}).map(([what, rate]) => `${rounded(rate)} ${what}/s`);
    if (health?.memory_bytes) rates.push(`${Math.round(health.memory_bytes / 1e6)} MB`);
    if (rates.length) row.append(element("span", rates.join(" · "), "rates"));
    return row;
  }));
  const sources = status.processes.flatMap((process) => process.sources);
  $("sources-box").hidden = !sources.length;
  $("sources").replaceChildren(...sources.map(({ name, outlier_rate }) => {
    const said = element("span", `${Math.round(100 * outlier_rate)} % false`);
    const row = element("li");
    row.classList.toggle("broken", outlier_rate > 0.5);
    row.append(element("span", name), said);
    return row;
  }));
  const dropped = Object.entries(status.counters).filter(([, count]) => count).map(([cause, count]) => `${cause}: ${count}`);
  if (status.steps_lost) dropped.unshift(`${status.steps_lost} steps lost`);
  if (status.reports_missing) dropped.unshift(`${status.reports_missing} reports missing`);
  $("health").textContent = `${status.steps_applied} steps applied${dropped.length ? "; " + dropped.join(", ") : ""}`;
}

function barOf(probability) {
  const bar = element("span", "", "bar"), filled = element("i");
  filled.style.width = `${100 * probability}%`;
  bar.append(filled);
  return bar;
}

function chip(slot) {
  const made = element("span", "", isDashed(slot) ? "chip dashed" : "chip");
  made.style.setProperty("--chip", colourOf(slot));
  return made;
}

function element(tag, text = "", className = "") {
  const made = document.createElement(tag);
  made.textContent = text;
  made.className = className;
  return made;
}

/** Show a line at the map's lower edge, for some time or until the next one. */
let hintEnds = 0;
export function hint(text, bad = false, forMs = 0) {
  clearTimeout(hintEnds);
  $("hint").textContent = text;
  $("hint").className = bad ? "bad" : "";
  $("hint").hidden = !text;
  if (forMs) hintEnds = setTimeout(() => hint(""), forMs);
}
