import type { Resource, Schema } from "rcp-client";

import { initial, main, resolve } from "./schema.ts";

/** How an actuator takes a forward speed and a turning rate, told by its schema. */
export interface Steering {
  /** The most it takes, in m/s and rad/s. */
  forward: number;
  turn: number;
  value: (forward: number, turn: number) => unknown;
}

const FORWARD = 1; // m/s where the schema sets no bound
const TURN = 1; // rad/s

function part(schema: Schema, root: Schema, name: string): Schema | undefined {
  const found = schema["properties"]?.[name];
  return found && main(resolve(found, root), root).schema;
}

const most = (schema: Schema | undefined, otherwise: number): number => schema?.["maximum"] ?? otherwise;

export function steering(resource: Resource): Steering | undefined {
  const root = resource.command_schema ?? resource.schemas?.value;
  if (!root) return undefined;
  const whole = main(resolve(root, root), root).schema;
  const nested = part(whole, root, "twist");
  const twist = nested ?? whole;
  const linear = part(twist, root, "linear");
  const angular = part(twist, root, "angular");
  if (linear && angular) {
    const within = (made: any, forward: number, turn: number): any => ({
      ...made,
      linear: { ...made.linear, x: forward },
      angular: { ...made.angular, z: turn },
    });
    return {
      forward: most(part(linear, root, "x"), FORWARD),
      turn: most(part(angular, root, "z"), TURN),
      value: (forward, turn) => {
        const made = initial(whole, root) as any;
        return nested ? { ...made, twist: within(made.twist ?? {}, forward, turn) } : within(made, forward, turn);
      },
    };
  }
  const x = part(whole, root, "x");
  const yaw = part(whole, root, "yaw_rate");
  if (!x || !yaw) return undefined;
  return {
    forward: most(x, FORWARD),
    turn: most(yaw, TURN),
    value: (forward, turn) => ({ ...(initial(whole, root) as object), x: forward, yaw_rate: turn }),
  };
}
