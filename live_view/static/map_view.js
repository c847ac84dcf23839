// The map with everything in it: drawn when something has changed, never twice in a frame.
import { colourOf, isDashed, percent, prepared, themed } from "./palette.js";

const MAX_SIDE = 4096; // of the picture of the map; a larger map is reduced, walls win
const LABELLED = 8; // clusters that say their percentage; the others are small
const RECENT_STEPS = 80; // of a way, drawn stronger
const ZOOM_RANGE = [0.5, 2000]; // pixels a metre

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.map = null; // { frame, cells, picture }
    this.view = { x: 0, y: 0, scale: 40 }; // what is in the middle [m]; pixels a metre
    this.step = null;
    this.history = [];
    this.pointed = null; // cluster under the pointer
    this.placing = null; // { from: [x, y], to: [x, y] } while an arrow is dragged
    this.follow = false;
    this.faded = false;
    this.onChange = () => {};
    this.due = false;
    this.onDrawn = () => {};
    new ResizeObserver(() => this.redraw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      if (this.map) this.map.picture = pictureOf(this.map);
      this.redraw();
    });
  }

  // --- what there is to draw ---

  setMap(frame, cells) {
    const another = !this.map || this.map.frame.cell_m * this.map.frame.cols !== frame.cell_m * frame.cols;
    this.map = { frame, cells };
    this.map.picture = pictureOf(this.map);
    if (another) this.fit();
    this.redraw();
  }

  setStep(step, history) {
    this.step = step;
    this.history = history;
    this.redraw();
  }

  // --- where one looks ---

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
    const [west, east, south, north] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const scale = Math.min((width - 48) / (east - west), (height - 136) / (north - south));
    this.view = { x: (west + east) / 2, y: (south + north) / 2, scale: bounded(scale) };
    this.setFollow(false);
  }

  setFollow(follow) {
    this.follow = follow;
    this.redraw();
    this.onChange();
  }

  lookAt([x, y]) {
    this.view.x = x;
    this.view.y = y;
    this.redraw();
  }

  pan(right, down) {
    this.view.x -= right / this.view.scale;
    this.view.y += down / this.view.scale;
    if (this.follow) this.setFollow(false);
    this.redraw();
  }

  /** Zoom, and keep what is at a point of the screen there. */
  zoom(factor, at = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const before = this.mapOf(at);
    this.view.scale = bounded(this.view.scale * factor);
    const after = this.mapOf(at);
    this.view.x += before[0] - after[0];
    this.view.y += before[1] - after[1];
    this.redraw();
  }

  /** A round length that fits into so many pixels [m]. */
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

  // --- drawing ---

  redraw() {
    if (this.due) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.draw();
    });
  }

  draw() {
    const places = this.step?.places ?? [];
    if (this.follow && places.length) [this.view.x, this.view.y] = places[0].pose;
    const { context, ratio, width, height } = prepared(this.canvas);
    this.context = context;
    if (this.map) this.drawMap(ratio, width, height);
    context.globalAlpha = this.faded ? 0.35 : 1;
    this.drawWays();
    if (this.step) {
      this.drawScan(places.find((place) => place.cluster === this.pointed) ?? places[0]);
      if (this.step.truth) this.drawTruth(this.step.truth);
      for (let i = places.length - 1; i >= 0; i--) this.drawPlace(places[i], i < LABELLED); // the best on top
    }
    context.globalAlpha = 1;
    if (this.placing) this.drawPlacing(this.placing);
    this.onDrawn();
  }

  drawMap(ratio, width, height) {
    const { context, view } = this;
    const { frame: { rows, cols, cell_m, origin }, picture } = this.map;
    const k = view.scale * ratio;
    context.save();
    context.setTransform(k, 0, 0, -k, (width / 2 - view.x * view.scale) * ratio, (height / 2 + view.y * view.scale) * ratio);
    context.translate(origin[0], origin[1]);
    context.rotate(origin[2]);
    context.scale(cell_m, -cell_m);
    context.imageSmoothingEnabled = view.scale * cell_m < 1.5;
    context.drawImage(picture, 0, -rows, cols, rows);
    context.restore();
  }

  drawWays() {
    const { context } = this;
    const ways = new Map();
    const truth = [];
    for (const [, places, real] of this.history) {
      for (const [cluster, slot, p, x, y] of places) {
        if (!ways.has(cluster)) ways.set(cluster, { slot, points: [], p });
        const way = ways.get(cluster);
        way.points.push([x, y]);
        way.p = p;
      }
      if (real) truth.push(real);
    }
    const alive = new Set((this.step?.places ?? []).map((place) => place.cluster));
    const usual = context.globalAlpha;
    context.lineJoin = context.lineCap = "round";
    if (truth.length > 1) {
      context.globalAlpha = usual * 0.45;
      context.strokeStyle = themed("--truth");
      context.lineWidth = 1.5;
      context.setLineDash([2, 5]);
      this.line(truth);
      context.setLineDash([]);
    }
    for (const [cluster, way] of ways) {
      if (!alive.has(cluster) || way.points.length < 2) continue;
      context.strokeStyle = colourOf(way.slot);
      context.lineWidth = 2.5;
      context.globalAlpha = usual * (0.1 + 0.15 * Math.sqrt(way.p));
      this.line(way.points.slice(0, 1 - RECENT_STEPS));
      context.globalAlpha = usual * (0.35 + 0.5 * Math.sqrt(way.p));
      this.line(way.points.slice(-RECENT_STEPS));
    }
    context.globalAlpha = usual;
  }

  /** A line through places; one that was set elsewhere jumps, and is not joined. */
  line(points) {
    const { context } = this;
    context.beginPath();
    let before = null;
    for (const point of points) {
      const [x, y] = this.screenOf(point);
      const jumps = !before || Math.hypot(point[0] - before[0], point[1] - before[1]) > 2;
      if (jumps) context.moveTo(x, y);
      else context.lineTo(x, y);
      before = point;
    }
    context.stroke();
  }

  drawScan(place) {
    if (!place) return;
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

  drawPlace(place, labelled) {
    const { context } = this;
    const usual = context.globalAlpha;
    const colour = colourOf(place.slot);
    const [x, y] = this.screenOf(place.pose);
    const radius = 6 + 8 * Math.sqrt(place.p);
    this.drawEllipse(place, x, y, colour, usual);
    // The arrow: a disc with a nose; its area tells the probability.
    context.save();
    context.translate(x, y);
    context.rotate(-place.pose[2]);
    context.beginPath();
    context.arc(0, 0, radius, 0.55, 2 * Math.PI - 0.55);
    context.lineTo(radius * 1.9, 0);
    context.closePath();
    context.lineWidth = 3;
    context.strokeStyle = themed("--halo");
    context.stroke();
    context.fillStyle = colour;
    context.fill();
    if (isDashed(place.slot) || place.cluster === this.pointed) {
      context.setLineDash(isDashed(place.slot) ? [3, 3] : []);
      context.lineWidth = 2;
      context.strokeStyle = themed("--ink");
      context.stroke();
    }
    context.restore();
    if (labelled || place.cluster === this.pointed) this.drawLabel(percent(place.p), x, y - radius - 11, colour);
  }

  drawEllipse(place, x, y, colour, usual) {
    const { context } = this;
    const [xx, xy, yy] = place.cov;
    const middle = (xx + yy) / 2, spread = Math.hypot((xx - yy) / 2, xy);
    const long = 2 * Math.sqrt(Math.max(middle + spread, 0)) * this.view.scale;
    const short = 2 * Math.sqrt(Math.max(middle - spread, 0)) * this.view.scale;
    context.beginPath();
    context.ellipse(x, y, Math.max(long, 1), Math.max(short, 1), -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
    context.fillStyle = context.strokeStyle = colour;
    context.globalAlpha = usual * (0.1 + 0.2 * place.p);
    context.fill();
    context.globalAlpha = usual;
    context.lineWidth = 1.5;
    context.setLineDash(isDashed(place.slot) ? [4, 3] : []);
    context.stroke();
    context.setLineDash([]);
  }

  drawLabel(text, x, y, colour) {
    const { context } = this;
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const width = context.measureText(text).width + 12;
    context.beginPath();
    context.roundRect(x - width / 2, y - 9, width, 18, 9);
    context.fillStyle = themed("--card");
    context.fill();
    context.lineWidth = 1.5;
    context.strokeStyle = colour;
    context.stroke();
    context.fillStyle = themed("--ink");
    context.fillText(text, x, y + 0.5);
  }

  drawTruth(pose) {
    const { context } = this;
    const [x, y] = this.screenOf(pose);
    context.save();
    context.translate(x, y);
    context.rotate(-pose[2]);
    for (const [width, colour] of [[5, themed("--halo")], [2.5, themed("--truth")]]) {
      context.lineWidth = width;
      context.strokeStyle = colour;
      context.beginPath();
      context.arc(0, 0, 19, 0, 2 * Math.PI);
      context.moveTo(19, 0);
      context.lineTo(30, 0);
      context.stroke();
    }
    context.restore();
  }

  drawPlacing({ from, to }) {
    const { context } = this;
    const [x, y] = this.screenOf(from), [toX, toY] = this.screenOf(to);
    const angle = Math.atan2(toY - y, toX - x), length = Math.max(Math.hypot(toX - x, toY - y), 24);
    context.save();
    context.strokeStyle = context.fillStyle = themed("--accent");
    context.globalAlpha = 0.18;
    context.beginPath();
    context.arc(x, y, 2 * 0.5 * this.view.scale, 0, 2 * Math.PI);
    context.fill();
    context.globalAlpha = 1;
    context.translate(x, y);
    context.rotate(angle);
    context.lineWidth = 4;
    context.lineCap = "round";
    context.beginPath();
    context.moveTo(0, 0);
    context.lineTo(length - 8, 0);
    context.stroke();
    context.beginPath();
    context.moveTo(length + 6, 0);
    context.lineTo(length - 10, 9);
    context.lineTo(length - 10, -9);
    context.fill();
    context.beginPath();
    context.arc(0, 0, 6, 0, 2 * Math.PI);
    context.fill();
    context.restore();
  }
}

const bounded = (scale) => Math.min(Math.max(scale, ZOOM_RANGE[0]), ZOOM_RANGE[1]);

/** The map as a picture of its own, drawn once; row 0 of the cells is its lowest line. */
function pictureOf({ frame: { rows, cols }, cells }) {
  const every = Math.ceil(Math.max(rows, cols) / MAX_SIDE);
  const width = Math.ceil(cols / every), height = Math.ceil(rows / every);
  const picture = document.createElement("canvas");
  [picture.width, picture.height] = [width, height];
  const context = picture.getContext("2d");
  const image = context.createImageData(width, height);
  const pixels = new Uint32Array(image.data.buffer);
  const [free, occupied, unknown] = ["--map-free", "--map-occupied", "--map-unknown"].map(littleEndian);
  pixels.fill(unknown);
  for (let row = 0; row < rows; row++) {
    const line = (height - 1 - Math.floor(row / every)) * width;
    for (let col = 0; col < cols; col++) {
      const cell = cells[row * cols + col], at = line + Math.floor(col / every);
      if (cell === 1) pixels[at] = occupied;
      else if (cell === 0 && pixels[at] !== occupied) pixels[at] = free;
    }
  }
  context.putImageData(image, 0, 0);
  return picture;
}

function littleEndian(name) {
  const [red, green, blue] = themed(name).match(/[0-9a-f]{2}/gi).map((digits) => parseInt(digits, 16));
  return ((255 << 24) | (blue << 16) | (green << 8) | red) >>> 0;
}
