// What the server tells goes where it is shown; what a person does goes to the server.
import { Connection } from "./connection.js";
import { fetchedCells } from "./map_picture.js";
import { MapView } from "./map_view.js";
import { hint, showAge, showClusters, showEvents, showPose, showRobots, showStep, showWorkers } from "./panel.js";
import { drawPlot, stepAt } from "./plot.js";
import { steer } from "./steering.js";
import { TimeTravel } from "./time_travel.js";

const $ = (id) => document.getElementById(id);
const USUAL_ROWS = 10000, AT_ONCE_ROWS = 1000, ASKED_FOR_ROWS_MS = 500, CONFIRMED_MS = 4000, BESIDES_EVERY_MS = 200, SLOW_MS = 50;
const ROW_PLACES = 16;

const view = new MapView($("map"));
const slots = new Map(); // of every cluster there has been
const now = { clouds: new Map() }; // the newest frames: step, pose, status, events; clouds by cluster
let rows = [], system = {};

const maxRows = () => system.kept_steps ?? USUAL_ROWS;
const connection = new Connection(take, () => {
  travel.onLost();
  showLink();
}, () => view.drawMs > SLOW_MS);
const travel = new TimeTravel(
  (step) => connection.send({ type: "past", step }),
  () => rows,
  (frames) => frames ? showPast(frames) : showNow(),
);
const steering = steer(view, {
  send: (message) => connection.send(message),
  mayCommand: () => Boolean(system.commands),
  isSimulated: () => Boolean(now.step?.truth),
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
    $("robot").textContent = [frame.robot, frame.saved_at].filter(Boolean).join(" · ");
    travel.setEnd(frame.link);
    $("actions").hidden = !frame.commands;
    showRobots(frame.robots ?? [], frame.robot);
    document.title = `${frame.robot} · Cluster-MCL`;
    if (frame.by_hand) steering.driveAtFirst();
    showLink();
  },
  async map(frame) {
    if (view.map?.frame.digest === frame.digest) return;
    const cells = await fetchedCells(frame);
    if (cells) view.setMap(frame, cells);
  },
  history(frame) {
    rows = frame;
    if (!rows.length) {
      [now.step, now.events] = [null, []];
      travel.toNow();
    }
    for (const row of rows) learnSlots(row[1]);
    showRows();
    if (rows.length >= AT_ONCE_ROWS) askForRowsBefore(rows[0][0]);
  },
  earlier(frame) {
    if (!frame.length) return;
    const first = frame[0][0], last = frame[frame.length - 1][0], known = rows[0]?.[0] <= first;
    rows = [...rows.filter((row) => row[0] < first), ...frame, ...rows.filter((row) => row[0] > last)].slice(-maxRows());
    for (const row of frame) learnSlots(row[1]);
    showRows();
    if (!known && first > 0 && frame.length >= AT_ONCE_ROWS && rows.length < maxRows()) askForRowsBefore(first);
  },
  past: (frames) => travel.onPast(frames),
  step(frame) {
    now.step = frame;
    while (rows.length && rows[rows.length - 1][0] >= frame.step) rows.pop();
    if (frame.step > (rows[rows.length - 1]?.[0] ?? -1) + 1) askForRowsBefore(frame.step); // some were skipped
    const likely = frame.places.slice(0, ROW_PLACES); // as in the rows that the server tells
    rows.push([frame.step, likely.map((p) => [p.cluster, p.slot, p.p, ...p.pose]), frame.truth]);
    if (rows.length > maxRows()) rows.shift();
    const isNews = learnSlots(frame.places.map((place) => [place.cluster, place.slot]));
    steering.onStep();
    if (travel.at !== null) {
      travel.onRows();
      return;
    }
    showMap(now);
    now.elsewhere = frame.elsewhere;
    if (isNews) now.eventsDue = true; // which are told before the step they belong to
    showBesidesSoon();
  },
  pose(frame) {
    [now.pose, now.poseAt] = [frame, performance.now()];
    now.elsewhere = frame.elsewhere ?? now.elsewhere;
    if (travel.at === null) showBesidesSoon();
  },
  status(frame) {
    now.status = frame;
    if (now.pose && frame.step === now.pose.step) {
      const { age_s, freshness, state } = frame;
      Object.assign(now.pose, { age_s, freshness, state });
      now.poseAt = performance.now();
    }
    if (travel.at !== null) return;
    if (now.pose) showPose(now.pose, now.poseAt);
    showWorkers(frame);
  },
  events(frame) {
    [now.events, now.eventsDue] = [frame, true];
    if (travel.at === null) showBesidesSoon();
  },
  done: ({ problem }) => hint(problem || "done", Boolean(problem), CONFIRMED_MS),
};
const ORDER = ["system", "map", "history", "past", "step", "pose", "status", "events", "done"];

/** What stands beside the map is read, not watched: it follows the map, five times a second. */
let soon = 0;
function showBesidesSoon() {
  soon ||= setTimeout(showBesides, BESIDES_EVERY_MS);
}

function showBesides() {
  soon = 0;
  if (travel.at !== null) return;
  if (now.step) {
    showStep(now.step);
    showClusters(now.step.places, view.pointed, now.elsewhere);
  }
  if (now.pose) showPose(now.pose, now.poseAt);
  if (now.eventsDue) showEvents(now.events ?? [], slots);
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

/** Steps that are missing, by haste or because they are old, come afterwards, and piece by piece. */
let asking = 0;
function askForRowsBefore(before) {
  clearTimeout(asking);
  asking = setTimeout(() => connection.send({ type: "earlier", before }), ASKED_FOR_ROWS_MS);
}

// --- what is shown: of now, or of a step that is looked back at ---------------------------------

function showNow() {
  showMap(now);
  if (now.status) showWorkers(now.status);
  now.eventsDue = true;
  showBesides();
}

function showPast(frames) {
  if (!frames.step) {
    hint("That step is not kept any more.", true, CONFIRMED_MS);
    return;
  }
  const clouds = Object.entries(frames).filter(([topic]) => topic.startsWith("cloud "));
  showMap({ step: frames.step, clouds: new Map(clouds.map(([, cloud]) => [cloud.cluster, cloud])) });
  showStep(frames.step);
  showClusters(frames.step.places, view.pointed, frames.step.elsewhere);
  if (frames.pose) showPose(frames.pose, null);
  if (frames.status) showWorkers(frames.status);
  showEvents(frames.events ?? [], slots);
  showRows();
}

function showMap({ step, clouds }) {
  view.clouds = clouds;
  view.setStep(step ?? null, rowsShown());
}

function showRows() {
  view.rows = rowsShown();
  view.redraw();
  drawPlot($("plot"), rows, travel.at);
  travel.onRows();
}

/** Up to the step that is shown. */
function rowsShown() {
  if (travel.at === null) return rows;
  const next = rows.findIndex((row) => row[0] > travel.at);
  return next < 0 ? rows : rows.slice(0, next);
}

function showLink() {
  const isLive = connection.isOpen && system.link === "running";
  const isPast = connection.isOpen && ["replaying", "finished", "saved"].includes(system.link);
  let text = "";
  if (!connection.isOpen) text = "The page's server does not answer: trying again. Is `clustermcl view` still running?";
  else if (system.link === "no router") text = `No router at ${system.router}: waiting for the system to start.`;
  else if (system.link === "no system") text = `The router is there, but nobody localizes ${system.robot} yet: waiting.`;
  else if (system.link === "replaying") text = "Reading the recording: more steps come.";
  $("banner").hidden = !text;
  $("banner-text").textContent = text;
  $("link").className = isLive || isPast ? "dot up" : "dot";
  $("link").title = text || (isPast ? "not live" : `connected to ${system.router}`);
  document.documentElement.dataset.link = connection.isOpen ? (system.link ?? "") : "no server";
  view.faded = !isLive && !isPast;
  view.redraw();
}

// --- what a person does beside the map ----------------------------------------------------------

$("clusters").addEventListener("click", ({ target }) => {
  const cluster = Number(target.closest("li")?.dataset.cluster);
  const place = view.step?.places.find((one) => one.cluster === cluster);
  if (place) view.lookAt(place.pose);
});
$("clusters").addEventListener("pointermove", ({ target }) => {
  const cluster = target.closest("li")?.dataset.cluster;
  view.pointed = cluster === undefined ? null : Number(cluster);
  view.redraw();
});
$("clusters").addEventListener("pointerleave", () => {
  view.pointed = null;
  view.redraw();
});
$("plot").addEventListener("click", (event) => {
  const step = stepAt($("plot"), rows, travel.at, event.offsetX);
  if (step !== null) travel.goTo(step);
});

view.onDrawn = () => {
  const length = view.roundLength(110);
  $("scale").firstElementChild.style.width = `${length * view.view.scale}px`;
  $("scale").lastElementChild.textContent = `${length} m`;
};

const plotAgain = () => drawPlot($("plot"), rows, travel.at);
setInterval(showAge, 200);
new ResizeObserver(plotAgain).observe($("plot"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", plotAgain);
showClusters([], null);
showEvents([], slots);
connection.open();

/** For tests, and for whoever is curious on the console. */
window.liveView = { view, take, travel, history: () => rows };
