// The most probable poses of the other robots behind the same router.
import { Connection } from "./connection.js";
import { OLD } from "./panel.js";

export class OtherRobots {
  /** @param changed called when a pose or a state has changed */
  constructor(changed) {
    Object.assign(this, { changed, robots: new Map() });
  }

  /** @param names of all robots; a connection is opened to each other one, once */
  listen(names, own) {
    for (const name of names) {
      if (name === own || this.robots.has(name)) continue;
      const robot = { name, state: "", believed: "", old: undefined, digest: "", pose: null };
      const take = (frames) => this.take(robot, frames);
      this.robots.set(name, robot);
      new Connection(take, () => this.take(robot, { system: {} }), () => false, `/robot/${name}/`).open();
    }
  }

  take(robot, { system, map, step, status }) {
    if (map) robot.digest = map.digest;
    if (step) Object.assign(robot, { believed: step.state, pose: step.places[0]?.pose ?? null });
    if (status) robot.old = OLD[status.freshness];
    robot.state = robot.old ?? robot.believed;
    if (system && system.link !== "running") Object.assign(robot, { state: "", believed: "", old: undefined, pose: null });
    if (system || map || step || status) this.changed();
  }

  /** The robots that are localized in a map. */
  in(digest) {
    return [...this.robots.values()].filter((robot) => robot.pose && robot.digest === digest);
  }
}
