// Trails of the clusters and of the ground truth, and advised ways.
import { colourOf, themed } from "./palette.js";

const SHOWN_PLACES = 16; // the most probable ones
const SHOWN_STEPS = 1000, RECENT_STEPS = 80; // the last ones are drawn stronger
const JUMP_M = 2;
const HEAT = 0.4, LEAST_HEAT = 0.2, SPOT_M = 0.5; // opacity; information of the strongest, at least [nat]; radius

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

/**
 * The advised ways from each place, the best one widest; finer where the robot must ask again first.
 * And heat: the more a view at a spot would tell, the stronger.
 */
export function drawAdvice(view) {
  const { context } = view, usual = context.globalAlpha;
  context.lineJoin = context.lineCap = "round";
  for (const { slot, pose, spots } of view.advice) {
    context.fillStyle = colourOf(slot);
    const most = Math.max(LEAST_HEAT, ...spots.map((spot) => spot[2]));
    for (const spot of spots) {
      context.globalAlpha = usual * HEAT * spot[2] / most;
      disc(view, inMap(pose, spot), SPOT_M * view.view.scale);
    }
  }
  for (const { slot, pose, ways } of view.advice) {
    context.strokeStyle = context.fillStyle = colourOf(slot);
    ways.forEach(({ poses, rest }, rank) => {
      const points = poses.map((one) => inMap(pose, one));
      context.globalAlpha = usual * (rank ? 0.5 : 1);
      context.lineWidth = rank ? 1.5 : 4;
      context.setLineDash([6, 6]);
      line(view, points);
      context.lineWidth = 1.5;
      context.setLineDash([1, 5]);
      line(view, [points.at(-1), ...rest.map((one) => inMap(pose, one))]);
      context.setLineDash([]);
      disc(view, points.at(-1), rank ? 3 : 6);
    });
  }
  context.globalAlpha = usual;
}

const inMap = ([x, y, heading], [along, across]) => {
  const c = Math.cos(heading), s = Math.sin(heading);
  return [x + c * along - s * across, y + s * along + c * across];
};

function disc(view, point, radius) {
  const { context } = view;
  context.beginPath();
  context.arc(...view.screenOf(point), radius, 0, 2 * Math.PI);
  context.fill();
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
