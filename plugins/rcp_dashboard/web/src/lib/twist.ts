import type { Resource, Schema } from "rcp-client";

import { initial, main, resolve } from "./schema.ts";

/** Along and about the robot's own axes: forward, to the left, up; turning to the left. In m/s and rad/s, or as parts of the most. */
export interface Speeds {
  forward: number;
  side: number;
  up: number;
  turn: number;
}

export const STILL: Speeds = { forward: 0, side: 0, up: 0, turn: 0 };

/** How an actuator takes speeds, told by its schema. */
export interface Steering {
  /** The most it takes; 0 along an axis that it does not have. */
  most: Speeds;
  value: (speeds: Speeds) => unknown;
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
  // A twist without bounds tells nothing of which axes there are: then it is driven as most of what drives.
  const bounds = (of: Schema, turn: Schema | undefined): Speeds => ({
    forward: most(part(of, root, "x"), FORWARD),
    side: most(part(of, root, "y"), 0),
    up: most(part(of, root, "z"), 0),
    turn: most(turn, TURN),
  });
  if (linear && angular) {
    const within = (made: any, { forward, side, up, turn }: Speeds): any => ({
      ...made,
      linear: { ...made.linear, x: forward, ...(side && { y: side }), ...(up && { z: up }) },
      angular: { ...made.angular, z: turn },
    });
    return {
      most: bounds(linear, part(angular, root, "z")),
      value: (speeds) => {
        const made = initial(whole, root) as any;
        return nested ? { ...made, twist: within(made.twist ?? {}, speeds) } : within(made, speeds);
      },
    };
  }
  const yaw = part(whole, root, "yaw_rate");
  if (!part(whole, root, "x") || !yaw) return undefined;
  return {
    most: bounds(whole, yaw),
    value: ({ forward, side, up, turn }) => ({ ...(initial(whole, root) as object), x: forward, ...(side && { y: side }), ...(up && { z: up }), yaw_rate: turn }),
  };
}
