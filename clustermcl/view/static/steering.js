// Pointer, wheel, keys and buttons: the visible section, and commands.
import { changeAt } from "./changes.js";
import { onFloor } from "./floors.js";
import { fixed } from "./palette.js";
import { hint } from "./panel.js";

const $ = (id) => document.getElementById(id);
const KEY_PAN = 60, KEY_ZOOM = 1.3, CLICK_PX = 4;
const IS_HELD = /^(Arrow|[+=.,-])/; // of other keys, being held means nothing
const USUAL_SPREAD_M = 0.5, SPREAD_RANGE_M = [0.05, 20];
const PLACING = { // meanings of an arrow dragged on the map
  "set_pose": ["set-pose", "Press where the robot is, drag to where it looks; wheel, + and −: how sure you are. Esc: no."],
  "kidnap": ["kidnap", "Press where the robot shall be put, drag to where it looks. K again: somewhere far away. Esc: no."],
};

export function steer(view, { send, mayCommand, isSimulated, travel }) {
  const canvas = view.canvas, pointers = new Map();
  let placing = null; // one of PLACING
  let pressedAt = [0, 0];

  const setPlacing = (what) => {
    placing = mayCommand() ? what : null;
    if (placing) travel.toNow();
    view.placing = null;
    canvas.classList.toggle("placing", placing !== null);
    for (const [one, [button]] of Object.entries(PLACING)) $(button).setAttribute("aria-pressed", String(one === placing));
    hint(placing ? PLACING[placing][1] : "");
    view.redraw();
  };
  const kidnap = () => {
    if (!mayCommand() || !isSimulated()) return;
    if (placing === "kidnap") {
      send({ type: "kidnap" });
      setPlacing(null);
    } else {
      setPlacing("kidnap");
    }
  };
  const update = () => {
    if (!mayCommand()) return;
    travel.toNow();
    send({ type: "update" });
  };
  const toggle = (layer) => {
    document.querySelector(`[data-layer=${layer}]`).setAttribute("aria-pressed", String(view.toggle(layer)));
  };
  const askToRelocalize = () => {
    if (mayCommand() && !$("confirm").open) $("confirm").showModal();
  };
  const at = (event) => [event.offsetX, event.offsetY];
  /** Zoom; while an arrow is dragged, change its uncertainty instead. */
  const widen = (factor, where) => {
    if (!view.placing?.spread) {
      view.zoom(factor, where);
      return;
    }
    view.placing.spread = Math.min(Math.max(view.placing.spread * factor, SPREAD_RANGE_M[0]), SPREAD_RANGE_M[1]);
    hint(`± ${view.placing.spread.toPrecision(2)} m`);
    view.redraw();
  };

  const startPlacing = (where) => {
    const from = view.mapOf(where);
    view.placing = { from, to: from, spread: placing === "set_pose" ? USUAL_SPREAD_M : 0 };
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    pressedAt = at(event);
    if (!placing) canvas.classList.add("dragging");
    else if (pointers.size === 1 && event.button === 0) startPlacing(at(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId), now = at(event);
    const point = view.mapOf(now), { x, y } = onFloor(point);
    $("cursor").textContent = [x, y].map((m, i) => `${"xy"[i]} ${fixed(m, 2)}`).join("  ") + " m" + changeAt(view, point);
    if (!before) {
      view.point(view.clusterAt(now));
      return;
    }
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = (point) => Math.max(Math.hypot(point[0] - other[0], point[1] - other[1]), 1);
      widen(apart(now) / apart(before), other);
    } else if (view.placing) {
      view.placing.to = view.mapOf(now);
      view.redraw();
    } else {
      view.pan(now[0] - before[0], now[1] - before[1]);
    }
    pointers.set(event.pointerId, now);
  });
  const release = (event) => {
    pointers.delete(event.pointerId);
    canvas.classList.remove("dragging");
    const isClick = Math.hypot(at(event)[0] - pressedAt[0], at(event)[1] - pressedAt[1]) < CLICK_PX;
    if (!placing && isClick && event.type === "pointerup") view.select(view.clusterAt(at(event)));
    if (!view.placing || pointers.size) return;
    const { from, to, spread } = view.placing, type = placing;
    setPlacing(null);
    if (event.type !== "pointerup") return;
    const heading = Math.atan2(to[1] - from[1], to[0] - from[0]);
    const { floor, x, y } = onFloor(from);
    if (type === "set_pose" && floor) send({ type, pose: [x, y, heading], floor: floor.name, position_sigma_m: spread });
    else send({ type, pose: [from[0], from[1], heading], ...(spread && { position_sigma_m: spread }) });
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    widen(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), at(event));
  }, { passive: false });

  const keys = {
    "+": () => widen(KEY_ZOOM),
    "=": () => widen(KEY_ZOOM),
    "-": () => widen(1 / KEY_ZOOM),
    ArrowLeft: () => view.pan(KEY_PAN, 0),
    ArrowRight: () => view.pan(-KEY_PAN, 0),
    ArrowUp: () => view.pan(0, KEY_PAN),
    ArrowDown: () => view.pan(0, -KEY_PAN),
    f: () => view.fit(),
    l: () => view.setFollow(!view.follow),
    p: () => setPlacing(placing === "set_pose" ? null : "set_pose"),
    u: update,
    r: askToRelocalize,
    k: kidnap,
    "?": () => $("keys").showModal(),
    Escape: () => (placing ? setPlacing(null) : view.select(null)),
    " ": () => travel.play(!travel.timer),
    ",": () => travel.next(-1),
    ".": () => travel.next(1),
    n: () => travel.toNow(),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    if (event.key === " " && event.target.closest("button, summary")) return; // presses it
    if (event.target === $("slider") && event.key.startsWith("Arrow")) return;
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    if (!event.repeat || IS_HELD.test(event.key)) act();
  });

  $("zoom-in").onclick = keys["+"];
  $("zoom-out").onclick = keys["-"];
  $("fit").onclick = keys.f;
  $("follow").onclick = keys.l;
  $("help").onclick = keys["?"];
  for (const button of $("layers").children) button.onclick = () => toggle(button.dataset.layer);
  canvas.addEventListener("pointerleave", () => ($("cursor").textContent = ""));
  $("set-pose").onclick = keys.p;
  $("update").onclick = update;
  $("advise").onclick = () => mayCommand() && send({ type: "advise" });
  $("relocalize").onclick = askToRelocalize;
  $("kidnap").onclick = kidnap;
  $("confirm-no").onclick = () => $("confirm").close();
  $("confirm-yes").onclick = () => {
    $("confirm").close();
    send({ type: "relocalize" });
  };
  view.onChange = () => $("follow").setAttribute("aria-pressed", String(view.follow));
  return {
    /** Disable the commands while no system is running. */
    onLink() {
      for (const button of $("actions").children) button.disabled = !mayCommand();
      $("actions").tabIndex = mayCommand() ? -1 : 0; // a narrow one scrolls, also with disabled buttons
      if (!mayCommand() && placing) setPlacing(null);
    },
    /** Another step is shown: what was said of the last one is over. */
    onTravel() {
      setPlacing(null);
    },
    onStatus() {
      $("kidnap").hidden = !isSimulated();
    },
  };
}
