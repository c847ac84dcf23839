// The floors of a building: tabs with their probabilities, and positions on each floor.
// What is drawn is in the atlas, in which the floors lie side by side.
import { whenReleased } from "./lists.js";
import { colourOf, percent } from "./palette.js";

let floors = []; // { name, shift: [x, y], low: [x, y], high: [x, y] }; none for a single map
let picked = null; // name of the chosen floor; null: that of the most probable place

/** The floor of a position in the atlas, and the position on it; of a single map, itself. */
export function onFloor([x, y]) {
  const off = ({ low, high }) => Math.max(low[0] - x, x - high[0], low[1] - y, y - high[1], 0);
  const floor = floors.reduce((best, one) => (best && off(best) <= off(one) ? best : one), null);
  return { floor, x: x - (floor?.shift[0] ?? 0), y: y - (floor?.shift[1] ?? 0) };
}

/** The probability of each floor, of places with their positions. */
export function byFloor(places) {
  const held = floors.map(({ name }, slot) => ({ name, slot, p: 0 }));
  for (const { p, at } of held.length ? places : []) held[floors.indexOf(onFloor(at).floor)].p += p;
  return held;
}

export function setFloors(view, frame) {
  floors = frame.floors ?? [];
  if (!floors.some(({ name }) => name === picked)) picked = null;
  view.floor = floors[0] ?? null;
}

/** Show this floor until another is chosen; null: that of the most probable place. */
export function pickFloor(floor) {
  picked = floor?.name ?? null;
}

/** Show the tabs, and on the map the chosen floor or that of the most probable place. */
export function showFloors(view, step) {
  const nav = document.getElementById("floors"), places = step?.places ?? [];
  nav.hidden = !floors.length;
  if (!floors.length) return;
  const best = places.length ? onFloor(places[0].pose).floor : view.floor;
  show(view, floors.find(({ name }) => name === picked) ?? best);
  whenReleased(nav, () => fillTabs(nav, view, step, best));
}

function fillTabs(nav, view, step, best) {
  const places = step?.places ?? [], focused = [...nav.children].indexOf(document.activeElement);
  nav.replaceChildren(...byFloor(places.map(({ p, pose }) => ({ p, at: pose }))).map(({ name, slot, p }) => {
    const tab = document.createElement("button");
    tab.textContent = `${name} ${percent(p)}`;
    tab.title = name === best.name ? "the floor of the most probable place; the map follows it" : "show this floor";
    tab.style.setProperty("--chip", colourOf(slot));
    tab.setAttribute("aria-pressed", String(name === view.floor.name));
    tab.onclick = () => {
      picked = name === best.name ? null : name;
      showFloors(view, step);
    };
    const others = places.filter(({ pose }) => onFloor(pose).floor.name === name);
    for (const { slot: own } of name === view.floor.name ? [] : others.slice(0, 8)) {
      const pill = document.createElement("i");
      pill.style.background = colourOf(own);
      tab.append(pill);
    }
    return tab;
  }));
  nav.children[focused]?.focus({ preventScroll: true });
}

function show(view, floor) {
  if (!floor || floor === view.floor) return;
  const [before, fitted] = [view.floor, view.isFitted];
  view.floor = floor;
  view.view.x += floor.shift[0] - before.shift[0];
  view.view.y += floor.shift[1] - before.shift[1];
  if (fitted) view.fit();
  view.redraw();
}
