// Draws the map and everything on it when something has changed, at most once in a frame.
import { BEAM_COLOURS, classifiedBeams } from "./beams.js";
import { drawChanges } from "./changes.js";
import { drawLandmarks, drawNames, drawSeen } from "./landmarks.js";
import { setFloors } from "./floors.js";
import { pictureOf } from "./map_picture.js";
import { prepared, themed } from "./palette.js";
import { drawParticles } from "./particles.js";
import { boxOf, drawLabels, drawPlace, drawPlacing, drawTruth } from "./symbols.js";
import { drawAdvice, drawWays } from "./ways.js";

const LABELLED = 8; // clusters with a percentage, where there is room
const MARGIN = 16; // around the map and the controls over it [px]
const ZOOM_RANGE = [0.5, 2000]; // pixels per metre

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.map = null; // { frame, cells, picture }
    this.floor = null; // the shown one of a building
    this.view = { x: 0, y: 0, scale: 40 }; // middle [m]; pixels per metre
    this.changes = null; // { digest, cell_m, stamp_s, cells }
    this.step = null;
    this.rows = []; // of the steps up to the shown one
    this.clouds = new Map(); // particles by cluster
    this.layers = new Set(["ellipses", "particles", "trails", "scan", "truth", "map", "changes"]);
    this.radius = 0; // of the robot's footprint [m]; 0: unknown
    this.advice = []; // { slot, pose, ways, spots } of each place
    this.pointed = null; // cluster under the pointer
    this.selected = null; // the cluster whose beams are classified
    this.placing = null; // { from: [x, y], to: [x, y], spread [m] } while an arrow is dragged
    this.follow = this.isFitted = false;
    this.faded = false;
    this.onChange = this.onPointed = () => {};
    this.due = false;
    this.drawMs = 0; // duration of the last drawing
    this.onDrawn = () => {};
    const resized = new ResizeObserver(() => (this.isFitted ? this.fit() : this.redraw()));
    for (const one of [canvas, ...["above", "tools", "timeline"].map((id) => document.getElementById(id))]) resized.observe(one);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (this.map) this.map.picture = pictureOf(this.map);
      this.redraw();
    });
  }

  // --- data ---

  setMap(frame, cells) {
    const another = !this.map || extent(this.map.frame) !== extent(frame);
    this.map = { frame, cells };
    this.map.picture = pictureOf(this.map);
    setFloors(this, frame);
    if (another) this.fit();
    this.redraw();
  }

  setStep(step, rows) {
    this.step = step;
    this.rows = rows;
    this.redraw();
  }

  // --- the visible section ---

  screenOf([x, y]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [width / 2 + (x - this.view.x) * this.view.scale, height / 2 - (y - this.view.y) * this.view.scale];
  }

  mapOf([left, top]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [this.view.x + (left - width / 2) / this.view.scale, this.view.y - (top - height / 2) / this.view.scale];
  }

  fit() {
    if (!this.map) return;
    const { rows, cols, cell_m, origin: [x, y, heading] } = this.map.frame;
    const w = cols * cell_m, h = rows * cell_m, c = Math.cos(heading), s = Math.sin(heading);
    const corners = [[0, 0], [w, 0], [w, h], [0, h]].map(([a, b]) => [x + c * a - s * b, y + s * a + c * b]);
    const xs = corners.map((corner) => corner[0]), ys = corners.map((corner) => corner[1]);
    let [west, east, south, north] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    if (this.floor) [[west, south], [east, north]] = [this.floor.low, this.floor.high];
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const [over, under, tools] = ["above", "below", "tools"].map((id) => document.getElementById(id));
    const above = MARGIN + over.offsetTop + over.offsetHeight;
    const below = MARGIN + height - under.offsetTop - tools.offsetTop;
    const scale = bounded(Math.min((width - 3 * MARGIN) / (east - west), Math.max(height - above - below, height / 4) / (north - south)));
    this.view = { x: (west + east) / 2, y: (south + north - (below - above) / scale) / 2, scale };
    this.setFollow(false);
    this.isFitted = true;
  }

  setFollow(follow) {
    this.follow = follow;
    this.isFitted = false;
    this.redraw();
    this.onChange();
  }

  lookAt([x, y]) {
    this.isFitted = false;
    this.view.x = x;
    this.view.y = y;
    this.redraw();
  }

  pan(right, down) {
    this.view.x -= right / this.view.scale;
    this.view.y += down / this.view.scale;
    if (this.follow) this.setFollow(false);
    this.isFitted = false;
    this.redraw();
  }

  /** Zoom about a point of the screen. */
  zoom(factor, at = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const before = this.mapOf(at);
    this.view.scale = bounded(this.view.scale * factor);
    const after = this.mapOf(at);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
    this.isFitted = false;
    this.redraw();
  }

  /** The largest round length that fits into this width [m]. */
  roundLength(pixels) {
    const most = pixels / this.view.scale, power = 10 ** Math.floor(Math.log10(most));
    return power * [5, 2, 1].find((digit) => digit * power <= most);
  }

  /** The cluster drawn at a point of the screen; null: none. */
  clusterAt([left, top]) {
    let nearest = null, least = 22;
    for (const place of this.step?.places ?? []) {
      const [x, y] = this.screenOf(place.pose);
      const distance = Math.hypot(x - left, y - top);
      if (distance < least) [nearest, least] = [place.cluster, distance];
    }
    return nearest;
  }

  point(cluster) {
    if (cluster === this.pointed) return;
    this.pointed = cluster;
    this.onPointed();
    this.redraw();
  }

  /** Classify the beams of a cluster; null: of none. */
  select(cluster) {
    this.selected = cluster;
    this.onPointed();
    this.redraw();
  }

  toggle(layer) {
    if (!this.layers.delete(layer)) this.layers.add(layer);
    this.redraw();
    return this.layers.has(layer);
  }

  // --- drawing ---

  redraw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      const begun = performance.now();
      this.draw();
      this.drawMs = performance.now() - begun;
    });
  }

  draw() {
    const places = this.step?.places ?? [];
    if (this.follow && places.length) [this.view.x, this.view.y] = places[0].pose;
    const { context, ratio, width, height } = prepared(this.canvas);
    const { layers } = this;
    this.context = context;
    this.beams = null;
    if (this.map && layers.has("map")) this.drawMap(ratio, width, height);
    if (this.changes && this.changes.digest === this.map?.frame.digest && layers.has("changes")) drawChanges(this);
    context.globalAlpha = this.faded ? 0.35 : 1;
    if (this.map) drawLandmarks(this);
    drawWays(this, this.rows, places);
    drawAdvice(this);
    const taken = []; // boxes that no name may cover
    if (this.step) {
      if (layers.has("particles")) drawParticles(this, this.clouds, this.step);
      const selected = places.find((place) => place.cluster === this.selected);
      if (selected && this.map && this.step.laser) this.drawBeams(selected);
      else if (layers.has("scan") && places.length) {
        const place = places.find((place) => place.cluster === this.pointed) ?? places[0];
        this.drawScan(place);
        drawSeen(this, place);
      }
      if (this.step.truth && layers.has("truth")) drawTruth(this, this.step.truth);
      for (let i = places.length - 1; i >= 0; i--) drawPlace(this, places[i]); // the best on top
      const pointed = places.filter((place) => place.cluster === this.pointed);
      taken.push(...places.map((place) => boxOf(this, place)), ...drawLabels(this, new Set([...pointed, ...places.slice(0, LABELLED)])));
    }
    if (this.map) drawNames(this, taken);
    context.globalAlpha = 1;
    if (this.placing) drawPlacing(this, this.placing);
    this.onDrawn();
  }

  drawMap(ratio, width, height) {
    const { context, view } = this;
    const { frame: { rows, cols, cell_m, origin }, picture } = this.map;
    const k = view.scale * ratio;
    context.save();
    if (this.floor) {
      const [left, low] = this.screenOf(this.floor.low), [right, high] = this.screenOf(this.floor.high);
      context.beginPath();
      context.rect(left, high, right - left, low - high);
      context.clip();
    }
    context.setTransform(k, 0, 0, -k, (width / 2 - view.x * view.scale) * ratio, (height / 2 + view.y * view.scale) * ratio);
    context.translate(origin[0], origin[1]);
    context.rotate(origin[2]);
    context.scale(cell_m, -cell_m);
    context.imageSmoothingEnabled = view.scale * cell_m < 1.5;
    context.drawImage(picture, 0, -rows, cols, rows);
    context.restore();
  }

  /** Draw the beams for and against a place. */
  drawBeams(place) {
    const { context } = this, usual = context.globalAlpha;
    const { from, classified } = classifiedBeams(this.map, place.pose, this.step);
    this.beams = [0, 0, 0];
    const start = this.screenOf(from);
    for (const { to, kind } of classified) {
      this.beams[kind] += 1;
      const [left, top] = this.screenOf(to);
      context.strokeStyle = context.fillStyle = themed(BEAM_COLOURS[kind]);
      context.globalAlpha = usual * (kind ? 0.55 : 0.2);
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(...start);
      context.lineTo(left, top);
      context.stroke();
      context.globalAlpha = usual;
      context.fillRect(left - 2, top - 2, 4, 4);
    }
  }

  drawScan(place) {
    const { context } = this;
    const [x, y, heading] = place.pose;
    const c = Math.cos(heading) / 100, s = Math.sin(heading) / 100, points = this.step.scan;
    const side = Math.max(2, Math.min(4, this.view.scale * 0.06));
    context.fillStyle = themed("--scan");
    for (let i = 0; i < points.length; i += 2) {
      const [left, top] = this.screenOf([x + c * points[i] - s * points[i + 1], y + s * points[i] + c * points[i + 1]]);
      context.fillRect(left - side / 2, top - side / 2, side, side);
    }
  }
}

const extent = ({ cell_m, cols, rows, origin }) => `${cell_m * cols} ${cell_m * rows} ${origin}`;
const bounded = (scale) => Math.min(Math.max(scale, ZOOM_RANGE[0]), ZOOM_RANGE[1]);
