// Particles of each cluster. They arrive about every tenth step; odometry moves them to the shown step.
import { colourOf } from "./palette.js";

const SIDE = 2.5; // of a particle [px]
const MOST = 4000; // of all clusters; with more, every second, third, ... particle is drawn

/** The robot's motion from the step of the particles to the shown step. */
export function motionBetween([x0, y0, heading0], [x1, y1]) {
  const c = Math.cos(heading0), s = Math.sin(heading0);
  return [c * (x1 - x0) + s * (y1 - y0), c * (y1 - y0) - s * (x1 - x0)];
}

/** Position of every `every`-th particle at a step: x, y, x, y, ... [m]. */
export function carried(cloud, odom, every = 1) {
  const [ahead, aside] = motionBetween(cloud.odom, odom), points = cloud.points;
  const places = new Float64Array(2 * Math.ceil(points.length / (3 * every)));
  for (let from = 0, to = 0; from < points.length; from += 3 * every, to += 2) {
    const c = Math.cos(points[from + 2] / 1000), s = Math.sin(points[from + 2] / 1000);
    places[to] = points[from] / 100 + c * ahead - s * aside;
    places[to + 1] = points[from + 1] / 100 + s * ahead + c * aside;
  }
  return places;
}

export function drawParticles(view, clouds, step) {
  const { context } = view, usual = context.globalAlpha;
  let count = 0;
  for (const place of step.places) count += (clouds.get(place.cluster)?.points.length ?? 0) / 3;
  const every = Math.max(1, Math.ceil(count / MOST));
  context.globalAlpha = usual * 0.55;
  for (let i = step.places.length - 1; i >= 0; i--) {
    const cloud = clouds.get(step.places[i].cluster);
    if (!cloud) continue;
    context.fillStyle = colourOf(step.places[i].slot);
    const places = carried(cloud, step.odom, every);
    for (let at = 0; at < places.length; at += 2) {
      const [x, y] = view.screenOf([places[at], places[at + 1]]);
      context.fillRect(x - SIDE / 2, y - SIDE / 2, SIDE, SIDE);
    }
  }
  context.globalAlpha = usual;
}
