import { Command } from "./command.ts";
import { RcpError } from "./errors.ts";
import { FINAL, type Reply, type WireError } from "./wire.ts";

interface StepFields {
  /** For results and reports; its position in the plan where there is none: `2`, `2.1`. */
  id?: string;
  /** A condition (CEL) on live values: the step is skipped if it is false. */
  when?: string;
  /** Whose values conditions use; the robot of the path where there is none, or the tenant's only one. */
  robot?: string;
  /** Seconds, all tries included. */
  deadline?: number;
  /** `on` has the codes of errors after which it is tried again; those that may pass where there is none. */
  retry?: { times: number; delay?: number; on?: string[] };
  /** What runs if it fails; the plan goes on after that. */
  fallback?: Step[];
  /** In a `parallel`: ids of the steps before it there that must be completed first. */
  after?: string[];
}

/** One step of a plan. `{ $result: "<id>/<field>" }` anywhere in a value stands for the result of an earlier one. */
export type Step =
  | (StepFields & { do: "read"; path: string; value?: unknown })
  | (StepFields & { do: "write"; path?: string; value: unknown; valid_for?: number })
  | (StepFields & { do: "execute"; path: string; value?: unknown })
  | (StepFields & { do: "sequence"; steps: Step[] })
  | (StepFields & { do: "parallel"; steps: Step[]; limit?: number; need?: "all" | "any" })
  | (StepFields & { do: "wait"; until: string; deadline: number });

/** A plan in one of its notations. */
export interface PlanBody {
  /** For people. */
  name?: string;
  steps?: Step[];
  /** What a PDDL planner put out: one `(action robot argument …)` a line. */
  symbolic?: string;
  /** One command a line: `execute /action/move_to x=1`. */
  lines?: string;
}

/** How far a step is. */
export interface StepState {
  step: string;
  do: Step["do"];
  state: "pending" | "running" | "completed" | "recovered" | "failed" | "skipped" | "cancelled";
  path?: string;
  tries?: number;
  progress?: number;
  /** What the robot last told while it runs. */
  feedback?: any;
  result?: any;
  /** The bytes of a result that is too long to be told. */
  omitted?: number;
  /** `result` is one page of a pattern; `cursor` leads to the next. */
  truncated?: boolean;
  cursor?: string;
  error?: WireError;
  message?: string;
  /** The gateway's id of what an `execute` runs. */
  command?: string;
  started?: string;
  ended?: string;
}

/** A request that a plan would send. */
export interface PlannedStep {
  step: string;
  do: Step["do"];
  path?: string;
  value?: any;
  /** Somebody has to approve it first. */
  approval?: boolean;
  [field: string]: unknown;
}

/**
 * A plan that runs. Iterating yields the state of the step that has changed last; `result` has those of all.
 *
 * `result` rejects if a step failed: `steps` says how far each came.
 */
export class Plan extends Command<StepState[], StepState> {
  /** The last state of each step that was told of, by its id; of all in their order, once it has ended. */
  readonly steps = new Map<string, StepState>();

  override take(reply: Reply): boolean {
    const whole: StepState[] | undefined = FINAL.has(reply.status) ? reply.body?.steps : undefined;
    if (whole !== undefined) this.steps.clear(); // into the order of the plan
    const told: StepState[] = whole ?? [reply.body];
    for (const state of told) if (state?.step !== undefined) this.steps.set(state.step, state);
    return super.take(reply.status === "completed" ? { ...reply, body: whole } : reply);
  }
}

const SYMBOLIC = /^\s*(?:;[^\n]*\n\s*)*(?:[\d.]+\s*:\s*)?\(/;
const WHOLE = /^\s*[[{]/;

/** Make the body of a plan of steps, or of a text: JSON, what a planner put out, or lines of commands. */
export function planOf(given: string | readonly Step[] | PlanBody): PlanBody {
  if (typeof given !== "string") return "length" in given ? { steps: [...given] } : given;
  if (SYMBOLIC.test(given)) return { symbolic: given };
  if (!WHOLE.test(given)) return { lines: given };
  try {
    return planOf(JSON.parse(given) as Step[] | PlanBody);
  } catch (problem) {
    const message = `the plan begins as JSON and is none: ${(problem as Error).message}`;
    const remedy = "Write a list of steps, or an object with `steps`, `symbolic` or `lines`.";
    throw new RcpError({ code: "bad_request", message, remedy, origin: "client" });
  }
}
