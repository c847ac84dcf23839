// Drives the simulated robot with the arrow keys. It stops a second after the last command.
import { hint } from "./panel.js";

const REPEATED_EVERY_MS = 150;
const RATES = { ArrowUp: [0.6, 0], ArrowDown: [-0.4, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] }; // [m/s, rad/s]

export class Driving {
  constructor(send) {
    Object.assign(this, { send, isOn: false, held: new Set(), timer: 0 });
  }

  set(on) {
    if (on === this.isOn) return;
    this.isOn = on;
    this.held.clear();
    clearInterval(this.timer);
    if (on) this.timer = setInterval(() => this.held.size && this.sendRates(), REPEATED_EVERY_MS);
    this.sendRates();
    document.getElementById("drive").setAttribute("aria-pressed", String(on));
    hint(on ? "Drive with the arrow keys. D: the robot drives by itself again." : "");
  }

  /** Return whether a key is used for driving. */
  onKey(key, isDown) {
    if (!this.isOn || !(key in RATES)) return false;
    const held = this.held.size;
    if (isDown) this.held.add(key);
    else this.held.delete(key);
    if (this.held.size !== held) this.sendRates();
    return true;
  }

  letGo() {
    if (!this.held.size) return;
    this.held.clear();
    this.sendRates();
  }

  sendRates() {
    const rates = [...this.held].map((key) => RATES[key]);
    const sum = (index) => rates.reduce((total, rate) => total + rate[index], 0);
    this.send({ type: "drive", speed_m_s: sum(0), turn_rate_rad_s: sum(1), by_hand: this.isOn });
  }
}
