export { Client, type CommandOptions, type Reading, type ReadOptions, type WriteOptions } from "./client.ts";
export { type Clock, Moment } from "./clock.ts";
export { Command, type Feedback } from "./command.ts";
export { ConnectionLost, RcpError } from "./errors.ts";
export { Lease } from "./lease.ts";
export { Plan, type PlanBody, type PlannedStep, type Step, type StepState } from "./plans.ts";
export type { SessionOptions, State } from "./session.ts";
export { type Handlers, Subscription } from "./subscription.ts";
export * from "./wire.ts";
