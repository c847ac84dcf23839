// Classifies each beam of a scan at a place: it hits a wall, passes through one, or ends short of all.
export const HIT = 0, THROUGH = 1, SHORT = 2;
export const BEAM_COLOURS = ["--good", "--through", "--short"];
const NEAR_M = 0.2;

/**
 * @param map its frame and cells
 * @param pose of the place: x, y, heading
 * @param step with its scan [cm, in the robot's frame] and the laser's position
 * @return the position in the map and the class of each end point
 */
export function classifiedBeams(map, [x, y, heading], { scan, laser }) {
  const c = Math.cos(heading) / 100, s = Math.sin(heading) / 100, classified = [];
  const mapOf = (ahead, aside) => [x + c * ahead - s * aside, y + s * ahead + c * aside];
  const from = mapOf(...laser);
  for (let i = 0; i < scan.length; i += 2) {
    const to = mapOf(scan[i], scan[i + 1]);
    classified.push({ to, kind: kindOf(map, from, to) });
  }
  return { from, classified };
}

function kindOf(map, [x0, y0], [x1, y1]) {
  const { cell_m } = map.frame, length = Math.hypot(x1 - x0, y1 - y0);
  const isWallAt = (m) => isOccupied(map, x0 + ((x1 - x0) * m) / length, y0 + ((y1 - y0) * m) / length);
  let wallEnds = null; // behind it there is free ground again
  for (let m = 0; m < length - NEAR_M; m += cell_m / 2) {
    if (isWallAt(m)) wallEnds = m;
    else if (wallEnds !== null && m - wallEnds > NEAR_M) return THROUGH;
  }
  for (let dx = -NEAR_M; dx <= NEAR_M; dx += cell_m) {
    for (let dy = -NEAR_M; dy <= NEAR_M; dy += cell_m) {
      if (Math.hypot(dx, dy) <= NEAR_M && isOccupied(map, x1 + dx, y1 + dy)) return HIT;
    }
  }
  return SHORT;
}

function isOccupied({ frame: { rows, cols, cell_m, origin }, cells }, x, y) {
  const c = Math.cos(origin[2]), s = Math.sin(origin[2]), dx = x - origin[0], dy = y - origin[1];
  const col = Math.floor((c * dx + s * dy) / cell_m), row = Math.floor((c * dy - s * dx) / cell_m);
  return col >= 0 && col < cols && row >= 0 && row < rows && cells[row * cols + col] === 1;
}
