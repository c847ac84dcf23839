// Probability of every cluster over the last steps.
import { byFloor } from "./floors.js";
import { colourOf, isDashed, percent, prepared, themed } from "./palette.js";

const LEFT = 40, RIGHT = 8, TOP = 6, BOTTOM = 18;
export const SHOWN_STEPS = 300;
const FULL_SCALES = [0.1, 0.2, 0.4, 1]; // so that many improbable clusters are visible

/** The first and last step of the plot: the newest, or those around a past step. */
function span(rows, oldest, at) {
  if (!rows.length) return [0, 0];
  const newest = rows[rows.length - 1][0];
  const last = Math.min(at === null ? newest : Math.max(at + SHOWN_STEPS / 2, oldest + SHOWN_STEPS), newest);
  return [Math.max(oldest, last - SHOWN_STEPS), last];
}

/** The step at a position of the plot [px from its left]; null: there are no steps. */
export function stepAt(canvas, rows, oldest, at, left) {
  const [first, last] = span(rows, oldest, at), right = canvas.clientWidth - RIGHT;
  if (!rows.length) return null;
  const step = first + ((left - LEFT) / (right - LEFT)) * Math.max(last - first, 20);
  return Math.round(Math.min(Math.max(step, first), last));
}

/**
 * @param oldest archived step; its row may not have arrived yet
 * @param at the past step that is shown; null: none
 * @param hovered the step under the pointer; null: none
 */
export function drawPlot(canvas, rows, oldest, at, hovered) {
  const { context, width, height } = prepared(canvas);
  const right = width - RIGHT, bottom = height - BOTTOM;
  const [first, last] = span(rows, oldest, at);
  const xOf = (step) => LEFT + ((step - first) / Math.max(last - first, 20)) * (right - LEFT);
  const lines = linesOf(rowsBetween(rows, first, last));
  const most = Math.max(...lines.map((line) => Math.max(...line.points.map(([, p]) => p))));
  const full = FULL_SCALES.find((scale) => lines.length && most <= scale) ?? 1;
  const yOf = (p) => bottom - (p / full) * (bottom - TOP);
  context.font = "11px system-ui, sans-serif";
  context.fillStyle = themed("--soft");
  context.strokeStyle = themed("--grid");
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const p of [0, full / 2, full]) {
    context.beginPath();
    context.moveTo(LEFT, Math.round(yOf(p)) + 0.5);
    context.lineTo(right, Math.round(yOf(p)) + 0.5);
    context.stroke();
    context.fillText(`${Math.round(100 * p)}%`, LEFT - 6, yOf(p));
  }
  if (!rows.length) return;
  context.textBaseline = "alphabetic";
  context.fillText(`step ${last}`, Math.max(xOf(last), LEFT + 60), height - 4);
  if (xOf(last) > LEFT + 120) {
    context.textAlign = "left";
    context.fillText(String(first), LEFT, height - 4);
  }
  context.lineWidth = 2;
  context.lineJoin = "round";
  for (const line of lines) {
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
  context.strokeStyle = themed("--ink");
  context.lineWidth = 1;
  context.beginPath();
  for (const step of [at, hovered]) {
    if (step === null) continue;
    context.moveTo(xOf(step), TOP);
    context.lineTo(xOf(step), bottom);
  }
  context.stroke();
}

const NAMED_PLACES = 3;

/** A step and its most probable places in words. */
export function rowText([step, places]) {
  const lines = inLines(places);
  if (lines !== places) return `step ${step}: ${lines.map(([name, , p]) => `${name} ${percent(p)}`).join(", ")}`;
  const named = places.slice(0, NAMED_PLACES).map(([cluster, , p]) => `place ${cluster} ${percent(p)}`);
  return `step ${step}: ${named.join(", ")}${places.length > NAMED_PLACES ? ", …" : ""}`;
}

function rowsBetween(rows, first, last) {
  const from = rows.findIndex((row) => row[0] >= first), to = rows.findLastIndex((row) => row[0] <= last);
  return from < 0 ? [] : rows.slice(from, to + 1);
}

/** The lines of a step: of the floors of a building, else of its places. */
function inLines(places) {
  const held = byFloor(places.map(([, , p, x, y]) => ({ p, at: [x, y] })));
  return held.length ? held.map(({ name, slot, p }) => [name, slot, p]) : places;
}

/** One line for each floor or cluster, in the order in which they began. */
function linesOf(rows) {
  const lines = new Map();
  for (const [step, places] of rows) {
    for (const [cluster, slot, p] of inLines(places)) {
      if (!lines.has(cluster)) lines.set(cluster, { slot, points: [] });
      lines.get(cluster).points.push([step, p]);
    }
  }
  return [...lines.values()];
}
