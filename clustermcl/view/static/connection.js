// The WebSocket to the server, reopened whenever it closes. A page saved as a file has none.
import { unpacked } from "./map_picture.js";
import { rowOf } from "./step_rows.js";

const LOOK_BACK_STEPS = 100; // as in `step_archive.py`
const LONGEST_PAUSE_MS = 4000, FIRST_PAUSE_MS = 250;
const DRAWN_EVERY = 3, DRAWN_WITHIN_MS = 250; // acknowledgement of drawn messages

export class Connection {
  /**
   * @param take called with the frames of each message
   * @param changed called when the connection opens or closes
   * @param isSlow whether messages should wait until the last one is drawn
   */
  constructor(take, changed, isSlow) {
    Object.assign(this, { take, changed, isSlow, socket: null, isOpen: false, pause: FIRST_PAUSE_MS, drawn: 0, timer: 0, taken: Promise.resolve() });
  }

  open() {
    const saved = document.getElementById("saved");
    if (saved) {
      this.isOpen = true;
      this.openSaved(JSON.parse(saved.textContent));
      return;
    }
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    this.socket = new WebSocket(new URL("live", `${scheme}://${location.host}${location.pathname}`));
    this.socket.onopen = () => {
      this.isOpen = true;
      this.drawn = 0;
      this.pause = FIRST_PAUSE_MS;
      this.changed();
    };
    this.socket.onmessage = ({ data }) => { // one after the other, also while a map is fetched
      this.taken = this.taken.catch(() => {}).then(() => this.onMessage(data));
    };
    this.socket.onclose = () => {
      this.isOpen = false;
      this.changed();
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
    };
  }

  async onMessage(data) {
    await this.take(JSON.parse(data));
    this.drawn += 1;
    if (this.drawn >= DRAWN_EVERY || this.isSlow()) this.acknowledge();
    else this.timer ||= setTimeout(() => this.acknowledge(), DRAWN_WITHIN_MS);
  }

  /** @param past [step, topic, frame] of all steps, packed */
  async openSaved({ past, ...frames }) {
    this.past = { entries: await unpacked(past).json(), events: frames.events ?? [] };
    const steps = this.past.entries.filter(([, topic]) => topic === "step");
    const rows = [...new Map(steps.map(([at, , frame]) => [at, rowOf(frame)])).values()];
    this.opened = this.take({ ...frames, history: { oldest: rows[0]?.[0] ?? 0, rows } });
  }

  /** What the server would answer. */
  pastAt(step) {
    const frames = { events: this.past.events.filter((event) => event.step <= step) };
    for (const [at, topic, frame] of this.past.entries) {
      if (at <= step && at >= step - LOOK_BACK_STEPS) frames[topic] = frame;
    }
    return frames;
  }

  acknowledge() {
    clearTimeout(this.timer);
    this.timer = 0;
    if (this.drawn) this.send({ type: "drawn", count: this.drawn, slow: this.isSlow() });
    this.drawn = 0;
  }

  send(message) {
    if (this.past && message.type === "past") this.opened.then(() => this.take({ past: this.pastAt(message.step) }));
    if (this.socket?.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }
}
