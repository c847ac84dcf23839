// Fills the panel next to the map.
import { BEAM_COLOURS } from "./beams.js";
import { colourOf, isDashed, percent } from "./palette.js";

const $ = (id) => document.getElementById(id);

const STALE_AFTER_S = 3;
const PROBABLY = 0.5; // as `clustermcl pose` says it

let pose = null, poseAt = null; // time of arrival [ms]; null: a past or recorded pose
let before = ""; // age of a past step, in words
let hasEnded = false; // the shown step is the last of the run

/** Links to the pages of all robots behind the router, with the states of the others. */
export function showRobots(names, own, others) {
  $("robots").hidden = !names.length;
  $("robots").replaceChildren(...names.map((name) => {
    const link = element("a", [name, others.get(name)?.state].filter(Boolean).join(": "));
    link.href = `/robot/${name}/`;
    if (name === own) link.setAttribute("aria-current", "page");
    return link;
  }));
}

export function showStep(frame) {
  $("now").dataset.state = frame.state;
  hasEnded = frame.last;
  const count = frame.places.length, isOne = frame.state === "localized";
  $("state").textContent = isOne || !count ? frame.state : `${frame.state}, ${count} place${count > 1 ? "s" : ""}`;
  const isOff = frame.off_map > PROBABLY;
  $("of").hidden = !isOff && (isOne || count < 2);
  $("of").textContent = isOff ? "probably not on this map" : "most probable of them:";
  $("searching").hidden = !frame.searching || (frame.state === "searching" && !frame.search_progress);
  $("searching").textContent = frame.search_progress > 0
    ? `searching ${Math.round(100 * frame.search_progress)} %` : "searching";
  $("step").textContent = frame.step;
  const best = frame.places[0];
  $("off-box").hidden = document.querySelector("[data-layer=truth]").hidden = !frame.truth;
  $("off").textContent = frame.truth && best
    ? `${Math.hypot(best.pose[0] - frame.truth[0], best.pose[1] - frame.truth[1]).toFixed(2)} m` : "–";
}

/**
 * @param at time of arrival [ms]; null: a past or recorded pose
 * @param ago age of a past step, in words; empty: it is the newest
 */
export function showPose(frame, at, ago = "") {
  [pose, poseAt, before] = [frame, at, ago];
  const [x, y, heading] = pose.pose ?? [];
  const sigma = pose.covariance ? [0, 4, 8].map((at) => Math.sqrt(Math.max(pose.covariance[at], 0))) : [];
  const shown = (value, error, unit) => value === undefined ? ["–"]
    : [value, element("small", error === undefined ? ` ${unit}` : ` ± ${error} ${unit}`)];
  $("x").replaceChildren(...shown(x?.toFixed(2), sigma[0]?.toFixed(2), "m"));
  $("y").replaceChildren(...shown(y?.toFixed(2), sigma[1]?.toFixed(2), "m"));
  const degrees = (value) => value && (value * 180 / Math.PI).toFixed(0);
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
  const freshness = hasEnded ? "ended" : isRecorded ? "recorded" : isLate ? "stale" : pose.freshness;
  $("now").dataset.freshness = freshness;
  const announced = { fresh: "", dead_reckoning: "dead reckoning" }[freshness] ?? freshness;
  announce([$("now").dataset.state, announced, before].filter(Boolean).join(", "));
  $("freshness").textContent = before || {
    ended: "the run has ended",
    recorded: "recorded",
    none: "no scan yet",
    fresh: `${seconds(age)} old`,
    stale: `stale, ${seconds(age)} old`,
    dead_reckoning: !pose.workers ? "dead reckoning: no worker is alive"
      : pose.scan_age_s < 0 ? "dead reckoning: no scan was used yet" : `dead reckoning: last scan ${seconds(pose.scan_age_s + since)} ago`,
  }[freshness];
}

/** Announce a change of the state to screen readers. */
function announce(text) {
  if ($("announced").textContent !== text) $("announced").textContent = text;
}

export const seconds = (s) => `${s < 10 ? s.toFixed(1) : s.toFixed(0)} s`;

export function showClusters(places, view, elsewhere, offMap) {
  const focused = document.activeElement.closest("#clusters li")?.dataset.cluster;
  $("cluster-count").textContent = places.length || "";
  const rows = places.map((place) => {
    const row = element("li"), button = element("button", "", "row");
    row.style.setProperty("--chip", colourOf(place.slot));
    row.title = `(${place.pose[0].toFixed(2)}, ${place.pose[1].toFixed(2)}) m, ${place.age} steps old; click to show it and its beams`;
    row.dataset.cluster = place.cluster;
    row.append(button);
    button.append(chip(place.slot), `c${place.cluster}`, barOf(place.p), element("b", percent(place.p)));
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
  $("beams").replaceChildren(`beams of c${cluster}:`, ...words);
}

export function showEvents(events, slots, nothing = "no events yet") {
  const rows = grouped(events).reverse().map((event) => {
    const cluster = /^c(\d+)$/.exec(event.job), slot = cluster && slots.get(Number(cluster[1]));
    const row = element("li", "", event.kind);
    row.append(slot == null ? element("span") : chip(slot), element("span", event.step, "step"), element("span", event.text));
    if (event.jobs.length > 1) row.title = event.jobs.join(", ");
    return row;
  });
  $("events").replaceChildren(...(rows.length ? rows : [element("li", nothing, "empty")]));
}

/** Join events of one step and one cause into one line. */
function grouped(events) {
  const lines = [];
  for (const event of events) {
    const line = lines[lines.length - 1], what = event.text.slice(event.job.length + 1).replace(/ \([^)]*\)$/, "");
    if (line?.step !== event.step || line.what !== what) {
      lines.push({ ...event, what, jobs: [event.job] });
      continue;
    }
    line.jobs.push(event.job);
    const isSearch = event.cause.startsWith("search "), many = what.replace(/^was /, "were ");
    line.text = isSearch ? `a search by ${line.jobs.length} jobs ${what}` : `${line.jobs[0]} and ${line.jobs.length - 1} more ${many}`;
  }
  return lines;
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
  $("sources").replaceChildren(...sources.map(({ name, recent_nat, broken_probability }) => {
    const said = element("span", `${rounded(recent_nat)} nat · broken ${Math.round(100 * broken_probability)} %`);
    const row = element("li");
    row.classList.toggle("broken", broken_probability > 0.5);
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
