// Symbols on the map: clusters, ground truth, the dragged arrow.
import { colourOf, isDashed, percent, themed } from "./palette.js";

/** A cluster: its ellipse, and a disc with a nose in its heading, whose area shows the probability. */
export function drawPlace(view, place) {
  const { context } = view;
  const usual = context.globalAlpha;
  const colour = colourOf(place.slot);
  const [x, y] = view.screenOf(place.pose);
  const radius = radiusOf(place);
  if (view.layers.has("ellipses")) drawEllipse(view, place, x, y, colour, usual);
  if (view.radius) drawFootprint(view, x, y, colour);
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
  if (isDashed(place.slot) || [view.pointed, view.selected].includes(place.cluster)) {
    context.setLineDash(isDashed(place.slot) ? [3, 3] : []);
    context.lineWidth = 2;
    context.strokeStyle = themed("--ink");
    context.stroke();
  }
  context.restore();
}

/** The robot's outline, in its true size. */
function drawFootprint({ context, radius, view }, x, y, colour) {
  context.beginPath();
  context.arc(x, y, radius * view.scale, 0, 2 * Math.PI);
  context.lineWidth = 1.5;
  context.strokeStyle = colour;
  context.stroke();
}

const radiusOf = (place) => 6 + 8 * Math.sqrt(place.p);

/** Percentages in order of importance, but for labels that would hide earlier ones; the boxes of those drawn. */
export function drawLabels(view, places) {
  const drawn = [];
  view.context.font = "600 12px system-ui, sans-serif";
  for (const place of places) {
    const text = percent(place.p), [x, y] = view.screenOf(place.pose);
    const width = view.context.measureText(text).width + 12;
    const box = { x, y: y - radiusOf(place) - 11, width, height: LABEL_HEIGHT };
    if (drawn.some((other) => overlap(box, other))) continue;
    drawn.push(box);
    drawLabel(view, text, box, colourOf(place.slot));
  }
  return drawn;
}

const LABEL_HEIGHT = 18;
export const overlap = (one, other) =>
  Math.abs(one.x - other.x) < (one.width + other.width) / 2 && Math.abs(one.y - other.y) < (one.height + other.height) / 2;

/** The square around a place's disc, as its middle and its size. */
export function boxOf(view, place) {
  const [x, y] = view.screenOf(place.pose), side = 2 * radiusOf(place);
  return { x, y, width: side, height: side };
}

function drawEllipse(view, place, x, y, colour, usual) {
  const { context } = view;
  const [xx, xy, yy] = place.cov;
  const middle = (xx + yy) / 2, spread = Math.hypot((xx - yy) / 2, xy);
  const long = 2 * Math.sqrt(Math.max(middle + spread, 0)) * view.view.scale;
  const short = 2 * Math.sqrt(Math.max(middle - spread, 0)) * view.view.scale;
  context.beginPath();
  context.ellipse(x, y, Math.max(long, 1), Math.max(short, 1), -Math.atan2(2 * xy, xx - yy) / 2, 0, 2 * Math.PI);
  context.fillStyle = context.strokeStyle = colour;
  context.globalAlpha = usual * (0.1 + 0.2 * place.p);
  context.fill();
  context.globalAlpha = usual * Math.min(1, 0.35 + 4 * place.p); // so that many improbable clusters do not hide the map
  context.lineWidth = 1.5;
  context.setLineDash(isDashed(place.slot) ? [4, 3] : []);
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = usual;
}

function drawLabel({ context }, text, { x, y, width }, colour) {
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.beginPath();
  context.roundRect(x - width / 2, y - LABEL_HEIGHT / 2, width, LABEL_HEIGHT, LABEL_HEIGHT / 2);
  context.fillStyle = themed("--card");
  context.fill();
  context.lineWidth = 1.5;
  context.strokeStyle = colour;
  context.stroke();
  context.fillStyle = themed("--ink");
  context.fillText(text, x, y + 0.5);
}

/** The ground truth: a ring with a stroke. */
export function drawTruth(view, pose) {
  const { context } = view;
  const [x, y] = view.screenOf(pose);
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

/** The dragged arrow, and two standard deviations of its position [m]. */
export function drawPlacing(view, { from, to, spread }) {
  const { context } = view;
  const [x, y] = view.screenOf(from), [toX, toY] = view.screenOf(to);
  const angle = Math.atan2(toY - y, toX - x), length = Math.max(Math.hypot(toX - x, toY - y), 24);
  context.save();
  context.strokeStyle = context.fillStyle = themed("--accent");
  context.globalAlpha = 0.18;
  context.beginPath();
  context.arc(x, y, 2 * spread * view.view.scale, 0, 2 * Math.PI);
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
