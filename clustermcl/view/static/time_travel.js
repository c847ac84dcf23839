// Looking back: a slider over the steps so far, play, and a link to a step.
const $ = (id) => document.getElementById(id);
const PLAYED_EVERY_MS = 100;

export class TimeTravel {
  /**
   * @param ask requests the frames of a step; onPast takes them
   * @param range the oldest and the newest archived step; null: there is none
   * @param show draws frames of a past step; null: the newest
   */
  constructor(ask, range, show) {
    Object.assign(this, { ask, range, show, at: null, asked: null, timer: 0, newest: "Now" });
    $("slider").addEventListener("input", () => this.goTo(Number($("slider").value)));
    $("play").onclick = () => this.play(!this.timer);
    $("to-now").onclick = () => this.toNow();
    addEventListener("hashchange", () => this.followLink());
    this.linked = linkedStep();
  }

  /** Show the step of the link, once the steps so far are known. */
  followLink() {
    const step = linkedStep();
    if (step !== null && step !== this.at) this.goTo(step);
  }

  /** Set whether the newest step is the end of a finished run. */
  setEnd(link) {
    this.newest = ["finished", "replaying"].includes(link) ? "End" : "Now";
    $("to-now").textContent = this.newest;
    this.onRows();
  }

  onRows() {
    const [oldest, newest] = this.range() ?? [0, 0], isShown = newest > oldest;
    $("timeline").hidden = !isShown;
    if (!isShown) return;
    $("slider").min = oldest;
    $("slider").max = newest;
    $("slider").value = this.at ?? $("slider").max;
    $("slider-step").textContent = this.at === null ? this.newest.toLowerCase() : `step ${this.at}`;
    $("to-now").disabled = this.at === null;
    document.documentElement.toggleAttribute("data-past", this.at !== null);
    if (this.linked !== null) {
      [this.linked] = [null];
      this.followLink();
    }
  }

  goTo(step) {
    this.at = step;
    history.replaceState(null, "", `#step=${step}`);
    this.onRows();
    if (this.asked === null) this.askFor(step); // else after the last answer, for the newest request only
  }

  askFor(step) {
    this.asked = step;
    this.ask(step);
  }

  onPast(frames) {
    const asked = this.asked;
    this.asked = null;
    if (this.at === null) return;
    this.show(frames);
    if (this.at !== asked) this.askFor(this.at);
  }

  /** The connection was opened again; requests before are lost. */
  onOpen() {
    this.asked = null;
    if (this.at !== null) this.askFor(this.at);
  }

  next(by = 1) {
    if (!this.range()) return;
    const [oldest, last] = this.range(), step = Math.max((this.at ?? last) + by, oldest);
    if (step > last || (step === last && by > 0)) this.toNow();
    else this.goTo(step);
  }

  /** Play from the shown past step, or from the first one, up to the newest. */
  play(on) {
    clearInterval(this.timer);
    const shown = () => this.asked === null; // no step is skipped
    this.timer = on ? setInterval(() => shown() && this.next(), PLAYED_EVERY_MS) : 0;
    if (on && this.at === null && this.range()) this.goTo(this.range()[0]);
    $("play").textContent = on ? "❚❚" : "▶";
    $("play").setAttribute("aria-pressed", String(on));
  }

  toNow() {
    this.play(false);
    if (this.at === null) return;
    this.at = null;
    history.replaceState(null, "", location.pathname + location.search);
    this.onRows();
    this.show(null);
  }
}

function linkedStep() {
  const named = /^#step=(\d{1,15})$/.exec(location.hash);
  return named ? Number(named[1]) : null;
}
