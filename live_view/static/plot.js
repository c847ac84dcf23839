// Probability of every cluster over the last steps.
import { colourOf, isDashed, prepared, themed } from "./palette.js";

const LEFT = 40, RIGHT = 8, TOP = 6, BOTTOM = 18;
const SHOWN_STEPS = 300;

export function drawPlot(canvas, history) {
  const { context, width, height } = prepared(canvas);
  const right = width - RIGHT, bottom = height - BOTTOM;
  const last = history.length ? history[history.length - 1][0] : 0;
  const first = Math.max(history.length ? history[0][0] : 0, last - SHOWN_STEPS);
  const xOf = (step) => LEFT + ((step - first) / Math.max(last - first, 20)) * (right - LEFT);
  const yOf = (p) => bottom - p * (bottom - TOP);
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = themed("--soft");
  context.strokeStyle = themed("--grid");
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const p of [0, 0.5, 1]) {
    context.beginPath();
    context.moveTo(LEFT, Math.round(yOf(p)) + 0.5);
    context.lineTo(right, Math.round(yOf(p)) + 0.5);
    context.stroke();
    context.fillText(`${100 * p}%`, LEFT - 6, yOf(p));
  }
  if (!history.length) return;
  context.textBaseline = "alphabetic";
  context.fillText(`step ${last}`, Math.max(xOf(last), LEFT + 60), height - 4);
  if (xOf(last) > LEFT + 120) {
    context.textAlign = "left";
    context.fillText(String(first), LEFT, height - 4);
  }
  context.lineWidth = 2;
  context.lineJoin = "round";
  for (const line of linesOf(history.filter((row) => row[0] >= first))) {
    context.strokeStyle = context.fillStyle = colourOf(line.slot);
    context.setLineDash(isDashed(line.slot) ? [4, 3] : []);
    context.beginPath();
    for (const [step, p] of line.points) context.lineTo(xOf(step), yOf(p));
    context.stroke();
    const [step, p] = line.points[line.points.length - 1];
    context.beginPath();
    context.arc(xOf(step), yOf(p), step === last ? 3 : 2, 0, 7);
    context.fill();
  }
  context.setLineDash([]);
}

/** One line for each cluster, in the order in which they began. */
function linesOf(rows) {
  const lines = new Map();
  for (const [step, places] of rows) {
    for (const [cluster, slot, p] of places) {
      if (!lines.has(cluster)) lines.set(cluster, { slot, points: [] });
      lines.get(cluster).points.push([step, p]);
    }
  }
  return lines.values();
}
