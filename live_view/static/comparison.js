// The same steps localized by AMCL, in a second map next to the first.
import { Connection } from "./connection.js";
import { fetchedCells } from "./map_picture.js";
import { MapView } from "./map_view.js";

const $ = (id) => document.getElementById(id);

export class Comparison {
  /** @param first the view of the first map, whose section is shown here, too */
  constructor(first) {
    Object.assign(this, { first, view: null, step: null, at: null, isOn: false });
  }

  /** @param name of the robot's page that shows AMCL's belief */
  toggle(name) {
    this.isOn = !this.isOn;
    if (this.isOn && !this.view) this.open(`/robot/${name}/`);
    document.documentElement.toggleAttribute("data-comparison", this.isOn);
    $("comparison").hidden = $("comparison-label").hidden = !this.isOn;
    $("with-amcl").setAttribute("aria-pressed", String(this.isOn));
    this.first.fit();
  }

  open(path) {
    this.view = new MapView($("comparison"));
    this.connection = new Connection((frames) => this.take(frames), () => {}, () => false, path);
    this.connection.open();
  }

  async take({ map, step, past }) {
    if (map) {
      const cells = await fetchedCells(map);
      if (cells) this.view.setMap(map, cells);
    }
    if (step) this.step = step;
    if (past && this.at !== null) this.show(past.step);
    else if (this.at === null) this.show(this.step);
  }

  /** @param at the step that is looked back at; null: now */
  lookAt(at) {
    if (!this.view || at === this.at) return;
    this.at = at;
    if (at === null) this.show(this.step);
    else this.connection.send({ type: "past", step: at });
  }

  show(step) {
    this.view.setStep(step ?? null, []);
    this.follow();
    const best = step?.places[0], { truth } = step ?? {};
    const off = best && truth ? Math.hypot(best.pose[0] - truth[0], best.pose[1] - truth[1]) : null;
    const text = `AMCL: ${step?.state ?? "no step yet"}${off === null ? "" : `, ${off.toFixed(1)} m off the truth`}`;
    if ($("comparison-label").textContent !== text) $("comparison-label").textContent = text;
    $("comparison-label").classList.toggle("bad", off > 1 && step.state === "localized");
  }

  /** Show the section and the layers of the first map. */
  follow() {
    if (!this.isOn || !this.view) return;
    this.view.isFitted = false;
    Object.assign(this.view, { view: { ...this.first.view }, layers: this.first.layers });
    this.view.redraw();
  }
}
