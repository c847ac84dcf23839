// The other robots behind the same router: where each most probably is, on the map of this one.
import { Connection } from "./connection.js";

export class OtherRobots {
  /** @param changed called when one of them has moved, or has another state */
  constructor(changed) {
    Object.assign(this, { changed, robots: new Map() });
  }

  /** @param names of all robots; each but the own one is listened to, once */
  listen(names, own) {
    for (const name of names) {
      if (name === own || this.robots.has(name)) continue;
      const robot = { name, state: "", digest: "", pose: null };
      const take = (frames) => this.take(robot, frames);
      this.robots.set(name, robot);
      new Connection(take, () => this.take(robot, { system: {} }), () => false, `/robot/${name}/`).open();
    }
  }

  take(robot, { system, map, step }) {
    if (map) robot.digest = map.digest;
    if (step) Object.assign(robot, { state: step.state, pose: step.places[0]?.pose ?? null });
    if (system && system.link !== "running") Object.assign(robot, { state: "", pose: null });
    if (system || map || step) this.changed();
  }

  /** Those that localize in a map. */
  in(digest) {
    return [...this.robots.values()].filter((robot) => robot.pose && robot.digest === digest);
  }
}
