// Trails of the clusters and of the ground truth, and advised ways.
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

/** The advised ways from each place, the best one widest. */
export function drawAdvice(view) {
  const { context } = view, usual = context.globalAlpha;
  context.lineJoin = context.lineCap = "round";
  for (const { slot, pose: [x, y, heading], ways } of view.advice) {
    const c = Math.cos(heading), s = Math.sin(heading);
    context.strokeStyle = context.fillStyle = colourOf(slot);
    ways.forEach(({ poses }, rank) => {
      const points = poses.map(([along, across]) => [x + c * along - s * across, y + s * along + c * across]);
      context.globalAlpha = usual * (rank ? 0.5 : 1);
      context.lineWidth = rank ? 1.5 : 4;
      context.setLineDash([6, 6]);
      line(view, points);
      context.setLineDash([]);
      context.beginPath();
      context.arc(...view.screenOf(points.at(-1)), rank ? 3 : 6, 0, 2 * Math.PI);
      context.fill();
    });
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
