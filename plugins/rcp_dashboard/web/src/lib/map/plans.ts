/** The plans of all robots, which outlive the page that shows them. */
import { app } from "../app.svelte.ts";
import { Plan } from "./plan.svelte.ts";

const plans = new Map<string, Plan>();
let epoch: number | undefined;

/** The plan of a robot, which outlives the page that shows it, and not the login: what was drawn is not lost by looking elsewhere. */
export function planOf(robot: string): Plan {
  if (epoch !== app.epoch) plans.clear();
  epoch = app.epoch;
  let found = plans.get(robot);
  if (!found) plans.set(robot, (found = new Plan(robot, (path) => app.client.execute(path).result)));
  return found;
}
