// Trails of the clusters, and of the ground truth.
import { colourOf, themed } from "./palette.js";

const SHOWN_PLACES = 16; // the most probable ones
const SHOWN_STEPS = 1000, RECENT_STEPS = 80; // the last ones are drawn stronger
const JUMP_M = 2;

export function drawWays(view, rows, places) {
  const { context, layers } = view;
  if (!layers.has("trails")) return;
  const ways = new Map(places.slice(0, SHOWN_PLACES).map((place) => [place.cluster, { slot: place.slot, p: place.p, points: [] }]));
  const truth = [];
  for (const [, past, real] of rows.slice(-SHOWN_STEPS)) {
    for (const [cluster, , , x, y] of past) ways.get(cluster)?.points.push([x, y]);
    if (real && layers.has("truth")) truth.push(real);
  }
  const usual = context.globalAlpha;
  context.lineJoin = context.lineCap = "round";
  if (truth.length > 1) {
    context.globalAlpha = usual * 0.45;
    context.strokeStyle = themed("--truth");
    context.lineWidth = 1.5;
    context.setLineDash([2, 5]);
    line(view, truth);
    context.setLineDash([]);
  }
  for (const { slot, p, points } of ways.values()) {
    if (points.length < 2) continue;
    context.strokeStyle = colourOf(slot);
    context.lineWidth = 2.5;
    context.globalAlpha = usual * (0.1 + 0.15 * Math.sqrt(p));
    line(view, points.slice(0, 1 - RECENT_STEPS));
    context.globalAlpha = usual * (0.35 + 0.5 * Math.sqrt(p));
    line(view, points.slice(-RECENT_STEPS));
  }
  context.globalAlpha = usual;
}

/** A line through positions, interrupted at jumps. */
function line(view, points) {
  const { context } = view;
  context.beginPath();
  let before = null;
  for (const point of points) {
    const [x, y] = view.screenOf(point);
    const jumps = !before || Math.hypot(point[0] - before[0], point[1] - before[1]) > JUMP_M;
    if (jumps) context.moveTo(x, y);
    else context.lineTo(x, y);
    before = point;
  }
  context.stroke();
}
