// Distributes the frames of the server to map and panel, and sends commands to the server.
import { showCaption } from "./captions.js";
import { Connection } from "./connection.js";
import { onFloor, pickFloor, showFloors } from "./floors.js";
import { fetchedCells } from "./map_picture.js";
import { MapView } from "./map_view.js";
import { clock, hint, isOld, markRows, seconds, showAge, showBeams, showClusters, showEvents, showPose, showStep, showWorkers } from "./panel.js";
import { drawPlot, rowText, SHOWN_STEPS, stepAt } from "./plot.js";
import { steer } from "./steering.js";
import { rowOf, StepRows } from "./step_rows.js";
import { TimeTravel } from "./time_travel.js";

const $ = (id) => document.getElementById(id);
const CONFIRMED_MS = 4000, SURE = 0.9, PANEL_EVERY_MS = 200, SLOW_MS = 50;
const RECORDED = ["replaying", "finished"]; // links without a running system

const view = new MapView($("map"));
const slots = new Map(); // colour slot of each cluster so far
const now = { clouds: new Map() }; // the newest frames: step, pose, status, events; clouds by cluster
let system = {};
let hovered = null; // step of the plot under the pointer

const known = new StepRows((before) => connection.send({ type: "earlier", before }));
const connection = new Connection(take, () => {
  if (connection.isOpen) travel.onOpen();
  showLink();
}, () => view.drawMs > SLOW_MS);
const travel = new TimeTravel(
  (step) => connection.send({ type: "past", step }),
  () => known.range,
  (frames) => frames ? showPast(frames) : showNow(),
);
const steering = steer(view, {
  send: (message) => connection.send(message),
  mayCommand: () => Boolean(system.commands) && isLive(),
  isSimulated: () => Boolean(now.status?.processes.some((process) => process.sender === "simulator")),
  travel,
});

async function take(frames) {
  for (const topic of Object.keys(frames).sort((a, b) => ORDER.indexOf(a) - ORDER.indexOf(b))) {
    if (topic in TAKE) await TAKE[topic](frames[topic]);
    else if (topic.startsWith("cloud ")) takeCloud(topic, frames[topic]);
  }
}

const TAKE = {
  system(frame) {
    system = frame;
    view.radius = frame.radius_m ?? 0;
    known.most = frame.kept_steps ?? known.most;
    $("robot").textContent = frame.robot;
    travel.setEnd(frame.link);
    $("actions").hidden = !frame.commands;
    document.title = `${frame.robot} · Cluster-MCL`;
    showLink();
  },
  async map(frame) {
    if (view.map?.frame.digest === frame.digest) return;
    const cells = await fetchedCells(frame);
    if (cells) view.setMap(frame, cells);
    showFloors(view, view.step);
  },
  changes(frame) {
    view.changes = frame;
    document.querySelector("[data-layer=changes]").hidden = !frame.cells.length;
    view.redraw();
  },
  history(frame) {
    const before = known.range;
    known.begin(frame);
    if (!(known.range?.[1] >= before?.[1])) { // steps are counted again
      [now.step, now.events] = [null, []];
      travel.toNow();
    }
    for (const row of known.rows) learnSlots(row[1]);
    showRows();
  },
  earlier(frame) {
    known.onEarlier(frame);
    for (const row of frame) learnSlots(row[1]);
    showRows();
  },
  past: (frames) => travel.onPast(frames),
  step(frame) {
    now.step = frame;
    known.add(rowOf(frame));
    if (frame.places[0]?.p >= SURE) view.advice = [];
    const isNews = learnSlots(frame.places.map((place) => [place.cluster, place.slot]));
    if (travel.at !== null) {
      travel.onRows();
      return;
    }
    showMap(now);
    [now.elsewhere, now.offMap] = [frame.elsewhere, frame.off_map];
    if (isNews) now.eventsDue = true; // events arrive before their step
    showPanelSoon();
  },
  pose(frame) {
    [now.pose, now.poseAt] = [frame, RECORDED.includes(system.link) ? null : performance.now()];
    [now.elsewhere, now.offMap] = [frame.elsewhere_probability, frame.off_map_probability];
    if (travel.at === null) showPanelSoon();
  },
  status(frame) {
    now.status = frame;
    if (now.pose && frame.step === now.pose.step) {
      const { age_s, scan_age_s, freshness, state } = frame;
      Object.assign(now.pose, { age_s, scan_age_s, freshness, state, workers: Object.keys(frame.workers).length });
      now.poseAt = performance.now();
    }
    showLink();
    steering.onStatus();
    if (travel.at !== null) return;
    if (now.pose) showPose(now.pose, now.poseAt);
    showWorkers(frame);
  },
  events(frame) {
    [now.events, now.eventsDue] = [frame, true];
    if (travel.at === null) showPanelSoon();
  },
  advice(frame) {
    const { ways, spots } = frame;
    view.advice = frame.clusters.map((cluster, i) => ({ slot: slots.get(cluster) ?? 0, pose: frame.places[i], ways, spots }));
    const [best] = frame.ways;
    const found = best && `The best way: ${best.length_m.toFixed(1)} m, ${best.information.toFixed(2)} nat expected.`;
    hint([found, frame.note].filter(Boolean).join(" "), !best, 2 * CONFIRMED_MS);
    view.redraw();
  },
  done: ({ problem }) => hint(problem || "done", Boolean(problem), CONFIRMED_MS),
};
const ORDER = ["system", "map", "history", "past", "step", "pose", "status", "events", "advice", "done"];

/** The panel follows the map five times a second, which is enough for reading. */
let soon = 0;
function showPanelSoon() {
  soon ||= setTimeout(showPanel, PANEL_EVERY_MS);
}

function showPanel() {
  soon = 0;
  if (travel.at !== null) return;
  if (now.step) {
    showStep(now.step);
    showClusters(now.step.places, view, now.elsewhere, now.offMap);
    if (system.story) showCaption(now.step, system.story);
  }
  if (now.pose) showPose(now.pose, now.poseAt);
  if (now.eventsDue) showTheEvents(now.events);
  now.eventsDue = false;
  showRows();
}

function takeCloud(topic, frame) {
  const cluster = Number(topic.slice("cloud ".length));
  if (frame) now.clouds.set(cluster, frame);
  else now.clouds.delete(cluster);
  if (travel.at === null) view.redraw();
}

function learnSlots(places) {
  const known = slots.size;
  for (const [cluster, slot] of places) slots.set(cluster, slot);
  return slots.size > known;
}

// --- what is shown: the newest step, or a past one ----------------------------------------------

function showNow() {
  steering.onTravel();
  showMap(now);
  if (now.status) showWorkers(now.status);
  now.eventsDue = true;
  showPanel();
}

/** Play a run that has ended from its first step; else search again. */
function again() {
  if (now.step.last) travel.play(true);
  else connection.send({ type: "relocalize" });
}

function showPast(frames) {
  steering.onTravel();
  if (system.story) showCaption(null);
  if (!frames.step) {
    if (!view.step) travel.toNow();
    hint("That step is no longer kept.", true, CONFIRMED_MS);
    return;
  }
  const clouds = Object.entries(frames).filter(([topic]) => topic.startsWith("cloud "));
  showMap({ step: frames.step, clouds: new Map(clouds.map(([, cloud]) => [cloud.cluster, cloud])) });
  showStep(frames.step);
  showClusters(frames.step.places, view, frames.step.elsewhere, frames.step.off_map);
  const ago = `${seconds(now.step.stamp_s - frames.step.stamp_s)} before ${travel.newest === "End" ? "the end" : "now"}`;
  if (frames.pose) showPose(frames.pose, null, ago);
  if (frames.status) showWorkers(frames.status);
  showTheEvents(frames.events);
  showRows();
}

function showTheEvents(events) {
  const isBag = RECORDED.includes(system.link) && !now.events?.length;
  showEvents(events ?? [], slots, isBag ? "this recording holds no events" : undefined);
}

function plotAgain() {
  drawPlot($("plot"), known.rows, known.oldest, travel.at, hovered);
}

function showMap({ step, clouds }) {
  showFloors(view, step);
  view.clouds = clouds;
  view.setStep(step ?? null, rowsShown());
  $("clock").textContent = step ? clock(step.stamp_s) : "";
}

function showRows() {
  view.rows = rowsShown();
  view.redraw();
  plotAgain();
  travel.onRows();
  known.askForGaps(travel.at === null ? Infinity : travel.at + SHOWN_STEPS / 2);
}

/** The rows up to the shown step. */
function rowsShown() {
  const { rows } = known;
  if (travel.at === null) return rows;
  const next = rows.findIndex((row) => row[0] > travel.at);
  return next < 0 ? rows : rows.slice(0, next);
}

function isLive() {
  return connection.isOpen && system.link === "running";
}

function showLink() {
  const isPast = connection.isOpen && RECORDED.includes(system.link);
  let text = "";
  if (!connection.isOpen) text = "The page's server does not answer; trying again. Is `clustermcl view` still running? If its link has a token, it has another one after a start.";
  else if (system.link === "no router") text = `No router at ${system.router}: waiting for the system to start.`;
  else if (system.link === "no system") text = `The router answers, but no coordinator localizes ${system.robot} yet: waiting.`;
  else if (system.link === "replaying") text = "Reading the recording: more steps follow.";
  else if (isLive() && now.status && !Object.keys(now.status.workers).length) text = "No worker is alive: odometry alone moves the pose.";
  $("banner").hidden = !text;
  $("banner-text").textContent = text;
  $("link").className = isLive() || isPast ? "dot up" : "dot";
  $("link").title = text || (isPast ? "not live" : `connected to ${system.router}`);
  document.documentElement.dataset.link = connection.isOpen ? (system.link ?? "") : "no server";
  steering.onLink();
  fade();
}

/** Fade what is drawn while it may have changed since. */
function fade() {
  const isShown = isLive() || (connection.isOpen && RECORDED.includes(system.link));
  view.faded = !isShown || isOld();
  view.redraw();
}

// --- input in the panel -------------------------------------------------------------------------

$("clusters").addEventListener("click", ({ target }) => {
  const cluster = Number(target.closest("li")?.dataset.cluster);
  const place = view.step?.places.find((one) => one.cluster === cluster);
  if (!place) return;
  pickFloor(onFloor(place.pose).floor);
  showFloors(view, view.step);
  view.lookAt(place.pose);
  view.select(view.selected === cluster ? null : cluster);
});
$("clusters").addEventListener("pointermove", ({ target }) => {
  const cluster = target.closest("li")?.dataset.cluster;
  view.point(cluster === undefined ? null : Number(cluster));
});
$("clusters").addEventListener("pointerleave", () => view.point(null));
view.onPointed = () => {
  markRows(view);
  const pointed = view.step?.places.find((place) => place.cluster === view.pointed);
  view.canvas.title = pointed?.why ? `place ${pointed.cluster}: ${pointed.why}` : "";
};
$("plot").addEventListener("click", (event) => {
  const step = stepAt($("plot"), known.rows, known.oldest, travel.at, event.offsetX);
  if (step !== null) travel.goTo(step);
});

$("plot").addEventListener("pointermove", (event) => {
  hovered = stepAt($("plot"), known.rows, known.oldest, travel.at, event.offsetX);
  const row = known.rows.find(([step]) => step === hovered);
  $("plot-at").hidden = !row;
  $("plot-at").textContent = row ? rowText(row) : "";
  plotAgain();
});
$("plot").addEventListener("pointerleave", () => {
  hovered = null;
  $("plot-at").hidden = true;
  plotAgain();
});

$("again").onclick = again;

view.onDrawn = () => {
  showBeams(view.selected, view.beams);
  const length = view.roundLength(80);
  $("scale").firstElementChild.style.width = `${length * view.view.scale}px`;
  $("scale").lastElementChild.textContent = `${length} m`;
};

setInterval(() => {
  showAge();
  if (isOld() !== view.faded) fade();
}, 200);
new ResizeObserver(plotAgain).observe($("plot"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", plotAgain);
showClusters([], view);
showEvents([], slots);
connection.open();

/** For tests and for the console. */
window.liveView = { view, take, travel, connection, history: () => known.rows, get system() { return system; } };
