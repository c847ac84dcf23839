// Hears the server, fills what stands beside the map, and takes what a person does.
import { MapView } from "./map_view.js";
import { colourOf, isDashed, percent } from "./palette.js";
import { drawPlot } from "./plot.js";
import { steer } from "./steering.js";

const $ = (id) => document.getElementById(id);
const MAX_HISTORY = 1000, SHOWN_CLUSTERS = 16, CONFIRMED_MS = 4000;

const view = new MapView($("map"));
const slots = new Map(); // of every cluster there has been
let socket = null, history = [], events = [], pose = null, poseAt = 0, system = {}, connected = false, pause = 250;

// --- the server -----------------------------------------------------------------------------

function connect() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/live`);
  socket.onopen = () => {
    connected = true;
    pause = 250;
  };
  socket.onmessage = async ({ data }) => {
    const frames = JSON.parse(data);
    for (const topic of Object.keys(TAKE)) {
      if (topic in frames) await TAKE[topic](frames[topic]);
    }
    send({ type: "drawn" });
  };
  socket.onclose = () => {
    connected = false;
    showLink();
    setTimeout(connect, pause);
    pause = Math.min(2 * pause, 4000);
  };
}

function send(message) {
  if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

// In this order: what comes first is drawn with by those after it.
const TAKE = {
  system(frame) {
    system = frame;
    $("robot").textContent = frame.robot;
    $("actions").hidden = !frame.commands;
    document.title = `${frame.robot} · Cluster-MCL`;
    showLink();
  },
  async map(frame) {
    if (view.map?.frame.digest === frame.digest) return;
    const answer = await fetch(`map/${frame.digest}`);
    const cells = new Uint8Array(await answer.arrayBuffer());
    if (answer.ok && cells.length === frame.rows * frame.cols) view.setMap(frame, cells);
  },
  history(rows) {
    history = rows;
    slots.clear();
    for (const [, places] of rows) for (const [cluster, slot] of places) slots.set(cluster, slot);
    if (!rows.length) view.setStep(null, history);
    drawPlot($("plot"), history);
  },
  step(frame) {
    const row = [frame.step, frame.places.map((p) => [p.cluster, p.slot, p.p, p.pose[0], p.pose[1]]), frame.truth];
    while (history.length && history[history.length - 1][0] >= frame.step) history.pop();
    history.push(row);
    if (history.length > MAX_HISTORY) history.shift();
    const known = slots.size;
    for (const place of frame.places) slots.set(place.cluster, place.slot);
    if (slots.size > known) showEvents(events); // which are told before the step they belong to
    view.setStep(frame, history);
    drawPlot($("plot"), history);
    showStep(frame);
    showClusters(frame.places);
  },
  pose(frame) {
    [pose, poseAt] = [frame, performance.now()];
    showPose();
  },
  status(frame) {
    if (pose && frame.step === pose.step) {
      Object.assign(pose, { age_s: frame.age_s, freshness: frame.freshness, state: frame.state });
      poseAt = performance.now();
      showPose();
    }
    showWorkers(frame);
  },
  events(frame) {
    events = frame;
    showEvents(events);
  },
  done({ problem }) {
    hint(problem || "done", Boolean(problem), CONFIRMED_MS);
  },
};

// --- beside the map ---------------------------------------------------------------------------

function showLink() {
  const running = connected && system.link === "running";
  let text = "";
  if (!connected) text = "The page's server does not answer: trying again. Is `clustermcl view` still running?";
  else if (system.link === "no router") text = `No router at ${system.router}: waiting for the system to start.`;
  else if (system.link === "no system") text = `The router is there, but nobody localizes ${system.robot} yet: waiting.`;
  $("banner").hidden = running;
  $("banner-text").textContent = text;
  $("link").className = running ? "dot up" : "dot";
  $("link").title = running ? `connected to ${system.router}` : text;
  document.documentElement.dataset.link = connected ? (system.link ?? "") : "no server";
  view.faded = !running;
  view.redraw();
}

function showStep(frame) {
  $("now").dataset.state = frame.state;
  $("state").textContent = frame.state;
  $("searching").hidden = !frame.searching || frame.state === "searching";
  $("step").textContent = frame.step;
  const best = frame.places[0];
  $("off-box").hidden = $("legend-truth").hidden = !frame.truth;
  $("off").textContent = frame.truth && best
    ? `${Math.hypot(best.pose[0] - frame.truth[0], best.pose[1] - frame.truth[1]).toFixed(2)} m` : "–";
}

function showPose() {
  const [x, y, heading] = pose.pose ?? [];
  const sigma = pose.sigma ?? [];
  const told = (value, error, unit) => value === undefined ? ["–"]
    : [value, element("small", error === undefined ? ` ${unit}` : ` ± ${error} ${unit}`)];
  $("x").replaceChildren(...told(x?.toFixed(2), sigma[0]?.toFixed(2), "m"));
  $("y").replaceChildren(...told(y?.toFixed(2), sigma[1]?.toFixed(2), "m"));
  const degrees = (value) => value && (value * 180 / Math.PI).toFixed(0);
  $("heading").replaceChildren(...told(degrees(heading), degrees(sigma[2]), "°"));
  $("probability").textContent = pose.pose ? percent(pose.p) : "–";
  showAge();
}

function showAge() {
  if (!pose) return;
  const age = pose.age_s + (performance.now() - poseAt) / 1000;
  const stale = pose.freshness === "stale" || age > 3;
  $("freshness").className = stale ? "stale" : "";
  $("freshness").textContent = pose.freshness === "none" ? "no scan yet"
    : `${stale ? "stale, " : ""}${age < 10 ? age.toFixed(1) : age.toFixed(0)} s old`;
}

function showClusters(places) {
  $("cluster-count").textContent = places.length || "";
  const rows = places.slice(0, SHOWN_CLUSTERS).map((place) => {
    const bar = element("span", "", "bar"), filled = element("i");
    filled.style.width = `${100 * place.p}%`;
    bar.append(filled);
    const row = element("li");
    row.style.setProperty("--chip", colourOf(place.slot));
    row.classList.toggle("pointed", place.cluster === view.pointed);
    row.title = `(${place.pose[0].toFixed(2)}, ${place.pose[1].toFixed(2)}) m, ${place.age} steps old; click to look there`;
    row.dataset.cluster = place.cluster;
    row.append(chip(place.slot), `c${place.cluster}`, bar, element("b", percent(place.p)));
    return row;
  });
  if (places.length > SHOWN_CLUSTERS) rows.push(element("li", `and ${places.length - SHOWN_CLUSTERS} less probable`, "more"));
  if (!places.length) rows.push(element("li", "no place is held possible yet", "more"));
  $("clusters").replaceChildren(...rows);
}

function showEvents(events) {
  const rows = grouped(events).reverse().map((event) => {
    const cluster = /^c(\d+)$/.exec(event.job), slot = cluster && slots.get(Number(cluster[1]));
    const row = element("li", "", event.kind);
    row.append(slot == null ? element("span") : chip(slot), element("span", event.step, "step"), element("span", event.text));
    return row;
  });
  $("events").replaceChildren(...(rows.length ? rows : [element("li", "nothing has begun or ended yet", "empty")]));
}

/** Searches that ended together are one line: there are as many as workers. */
function grouped(events) {
  const lines = [];
  for (const event of events) {
    const before = lines[lines.length - 1];
    const alike = before && before.step === event.step && before.cause === event.cause;
    if (alike && event.cause.startsWith("search ")) {
      before.count += 1;
      before.text = event.cause.replace("search", `a search by ${before.count} jobs is`).replace("is stopped", "was stopped");
    } else {
      lines.push({ ...event, count: 1 });
    }
  }
  return lines;
}

function showWorkers(status) {
  $("worker-count").textContent = status.workers.length || "none is alive";
  $("workers").replaceChildren(...status.workers.map((worker) => {
    const jobs = element("span", "", "jobs"), row = element("li");
    for (const job of worker.jobs) jobs.append(element("span", job, "job"));
    if (!worker.jobs.length) jobs.append(element("span", "idle", "idle"));
    row.append(element("span", worker.name), jobs);
    const rates = Object.entries(worker.rates ?? {}).map(([what, rate]) => `${rate} ${what}/s`);
    if (worker.mb) rates.push(`${worker.mb} MB`);
    if (rates.length) row.append(element("span", rates.join(" · "), "rates"));
    return row;
  }));
  const dropped = Object.entries(status.dropped).map(([cause, count]) => `${cause}: ${count}`);
  if (status.lost) dropped.unshift(`${status.lost} steps lost`);
  if (status.reports_missing) dropped.unshift(`${status.reports_missing} reports missing`);
  $("health").textContent = `${status.applied} steps applied${dropped.length ? "; " + dropped.join(", ") : ""}`;
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

let hintEnds = 0;
function hint(text, bad = false, forMs = 0) {
  clearTimeout(hintEnds);
  $("hint").textContent = text;
  $("hint").className = bad ? "bad" : "";
  $("hint").hidden = !text;
  if (forMs) hintEnds = setTimeout(() => hint(""), forMs);
}

// --- what a person does -----------------------------------------------------------------------

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

view.onDrawn = () => {
  const length = view.roundLength(110);
  $("scale").firstElementChild.style.width = `${length * view.view.scale}px`;
  $("scale").lastElementChild.textContent = `${length} m`;
};

steer(view, { send, hint, mayCommand: () => Boolean(system.commands) });
setInterval(showAge, 200);
new ResizeObserver(() => drawPlot($("plot"), history)).observe($("plot"));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawPlot($("plot"), history));
showClusters([]);
showEvents([]);
connect();

/** For tests, and for whoever is curious on the console. */
window.liveView = { view, history: () => history };
