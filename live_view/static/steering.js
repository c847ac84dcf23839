// Pointer, wheel, keys and buttons: where one looks, and the two commands.

const $ = (id) => document.getElementById(id);
const KEY_PAN = 60, KEY_ZOOM = 1.3;

export function steer(view, { send, hint, mayCommand }) {
  const canvas = view.canvas, pointers = new Map();
  let placing = false;

  const setPlacing = (on) => {
    placing = on && mayCommand();
    view.placing = null;
    canvas.classList.toggle("placing", placing);
    $("set-pose").setAttribute("aria-pressed", String(placing));
    hint(placing ? "Press where the robot is, drag to where it looks. Esc: no." : "");
    view.redraw();
  };
  const askToRelocalize = () => {
    if (mayCommand() && !$("confirm").open) $("confirm").showModal();
  };
  const at = (event) => [event.offsetX, event.offsetY];

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, at(event));
    if (placing) view.placing = { from: view.mapOf(at(event)), to: view.mapOf(at(event)) };
    else canvas.classList.add("dragging");
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId), now = at(event);
    if (!before) {
      view.pointed = view.clusterAt(now);
      view.redraw();
      return;
    }
    if (view.placing) {
      view.placing.to = view.mapOf(now);
      view.redraw();
    } else if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const apart = (point) => Math.max(Math.hypot(point[0] - other[0], point[1] - other[1]), 1);
      view.zoom(apart(now) / apart(before), other);
    } else {
      view.pan(now[0] - before[0], now[1] - before[1]);
    }
    pointers.set(event.pointerId, now);
  });
  const release = (event) => {
    pointers.delete(event.pointerId);
    canvas.classList.remove("dragging");
    if (!view.placing) return;
    const { from, to } = view.placing;
    setPlacing(false);
    if (event.type !== "pointerup") return;
    const heading = Math.atan2(to[1] - from[1], to[0] - from[0]);
    send({ type: "set_pose", pose: [from[0], from[1], heading] });
  };
  canvas.addEventListener("pointerup", release);
  canvas.addEventListener("pointercancel", release);
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.zoom(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0015)), at(event));
  }, { passive: false });

  const keys = {
    "+": () => view.zoom(KEY_ZOOM),
    "=": () => view.zoom(KEY_ZOOM),
    "-": () => view.zoom(1 / KEY_ZOOM),
    ArrowLeft: () => view.pan(KEY_PAN, 0),
    ArrowRight: () => view.pan(-KEY_PAN, 0),
    ArrowUp: () => view.pan(0, KEY_PAN),
    ArrowDown: () => view.pan(0, -KEY_PAN),
    f: () => view.fit(),
    l: () => view.setFollow(!view.follow),
    p: () => setPlacing(!placing),
    r: askToRelocalize,
    Escape: () => setPlacing(false),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || $("confirm").open) return;
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  });

  $("zoom-in").onclick = keys["+"];
  $("zoom-out").onclick = keys["-"];
  $("fit").onclick = keys.f;
  $("follow").onclick = keys.l;
  $("set-pose").onclick = keys.p;
  $("relocalize").onclick = askToRelocalize;
  $("confirm-no").onclick = () => $("confirm").close();
  $("confirm-yes").onclick = () => {
    $("confirm").close();
    send({ type: "relocalize" });
  };
  view.onChange = () => $("follow").setAttribute("aria-pressed", String(view.follow));
}
