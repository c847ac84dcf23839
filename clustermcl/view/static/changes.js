// What has changed in the building: gone, new, and moving cells, fainter the longer they were not seen.
import { themed } from "./palette.js";
import { seconds } from "./panel.js";

const KINDS = [["gone", "--scan"], ["new", "--short"], ["moving", "--moving"]];
const FADED_S = 7 * 86400, LEAST = 0.3;

export function drawChanges(view) {
  const { context, changes: { cells, cell_m, stamp_s } } = view;
  const side = Math.max(cell_m * view.view.scale, 2), usual = context.globalAlpha;
  for (const [x, y, kind, , , seen] of cells) {
    const [left, top] = view.screenOf([x, y]);
    context.fillStyle = themed(KINDS[kind][1]);
    context.globalAlpha = usual * Math.max(Math.exp((seen - stamp_s) / FADED_S), LEAST);
    context.fillRect(left - side / 2, top - side / 2, side, side);
  }
  context.globalAlpha = usual;
}

/** What has changed at a point of the map, since when, and how often it was seen; empty: nothing. */
export function changeAt({ changes, layers }, [x, y]) {
  if (!changes || !layers.has("changes")) return "";
  const half = changes.cell_m / 2;
  const cell = changes.cells.find(([at, up]) => Math.abs(at - x) <= half && Math.abs(up - y) <= half);
  if (!cell) return "";
  const [, , kind, sights, since, seen] = cell;
  return `  ${KINDS[kind][0]}: seen ${sights} times in ${seconds(seen - since)}, last ${seconds(changes.stamp_s - seen)} ago`;
}
