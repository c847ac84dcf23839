// The map's landmarks, and what the robot has just seen of them.
import { themed } from "./palette.js";
import { overlap } from "./symbols.js";

const NAMED = 25; // pixels per metre from which landmarks have names
const SIDE = 5, NAME_HEIGHT = 14;

export function drawLandmarks(view) {
  const { context } = view, seen = new Set((view.step?.seen ?? []).map(([name]) => name));
  for (const [name, x, y] of view.map.frame.landmarks) {
    const [left, top] = view.screenOf([x, y]);
    context.fillStyle = themed(seen.has(name) ? "--scan" : "--ink");
    context.beginPath();
    for (const [right, down] of [[0, -SIDE], [SIDE, 0], [0, SIDE], [-SIDE, 0]]) context.lineTo(left + right, top + down);
    context.fill();
  }
}

/**
 * Names of landmarks, above them or, where something is drawn there, below.
 * @param taken boxes that stay free
 */
export function drawNames(view, taken) {
  if (view.view.scale < NAMED) return [];
  const { context } = view, drawn = [];
  Object.assign(context, { font: "11px system-ui, sans-serif", textAlign: "center", textBaseline: "middle", lineWidth: 3 });
  context.strokeStyle = themed("--halo");
  context.fillStyle = themed("--ink");
  for (const [name, x, y] of view.map.frame.landmarks) {
    const [left, top] = view.screenOf([x, y]), width = context.measureText(name).width;
    const boxes = [-1, 1].map((side) => ({ x: left, y: top + 3 * side * SIDE, width, height: NAME_HEIGHT }));
    const box = boxes.find((one) => !taken.some((other) => overlap(one, other)));
    if (!box) continue;
    drawn.push({ name, ...box });
    context.strokeText(name, box.x, box.y);
    context.fillText(name, box.x, box.y);
  }
  return drawn;
}

/** Rays from a place to where landmarks were seen from there, and a ring at a reported position. */
export function drawSeen(view, place) {
  const { context, step } = view, [x, y, heading] = place.pose;
  const c = Math.cos(heading), s = Math.sin(heading);
  context.strokeStyle = themed("--scan");
  context.lineWidth = 1.5;
  for (const [name, a, b] of step.seen) {
    context.beginPath();
    if (name) {
      context.moveTo(...view.screenOf([x, y]));
      context.lineTo(...view.screenOf([x + c * a - s * b, y + s * a + c * b]));
    } else {
      context.arc(...view.screenOf([a, b]), 2 * SIDE, 0, 2 * Math.PI);
    }
    context.stroke();
  }
}
