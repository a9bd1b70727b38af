import type { Clock } from "./clock.ts";
import { Command } from "./command.ts";
import { RcpError } from "./errors.ts";
import { Lease } from "./lease.ts";
import { Plan, type PlanBody, type PlannedStep, planOf, type Step } from "./plans.ts";
import { Session, type SessionOptions, type State } from "./session.ts";
import { type Handlers, Subscription } from "./subscription.ts";
import type {
  Catalogue, Discovered, DiscoverOptions, EstopState, Held, Hello, Item, LeaseState, Notice, Reply, Request, Resource,
  SubscribeOptions, Untyped, Update,
} from "./wire.ts";

export interface ReadOptions {
  fields?: string[];
  /** The frame of the value: `map`, `base_link`, `earth`. */
  frame?: string;
  /** Only what these words find, where a path has a search: `/system/robots`. */
  q?: string;
  /** Ask the robot, even where a sample is at hand. */
  fresh?: boolean;
  deadline?: number;
}

export interface CommandOptions {
  /** Check the request without changing anything. */
  dryRun?: boolean;
  deadline?: number;
  idempotencyKey?: string;
  /** Of a person's approval that lets it pass, once. */
  approval?: string;
}

export interface WriteOptions extends CommandOptions {
  /** Seconds that a write to an actuator stands. */
  validFor?: number;
}

/** A value with what is known about it. */
export interface Reading<T> {
  value: T;
  seq: number | undefined;
  timestamp: string | undefined;
  state: "fresh" | "stale" | undefined;
}

type Paths<T> = Extract<keyof T, string>;
type Of<T, P> = P extends keyof T ? T[P] : never;
type Part<T, P, K extends string> = Of<T, P> extends Record<K, infer V> ? V : never;

/** The path of a robot's `service/hold`. */
function holdOf(robot: string | undefined): string {
  if (robot === undefined) return "/service/hold";
  if (!robot.startsWith("/")) return `/service/${robot}/hold`;
  const parts = robot.split("/"); // "", "tenant", the tenant's name, and the robot's
  return [...parts.slice(0, 3), "service", ...parts.slice(3), "hold"].join("/");
}

const PLANS = "/system/plans";
const LEASE = 10; // s, the gateway's own default
const ESTOP = 10; // s for robots to be confirmed at rest

/**
 * A gateway, over one WebSocket that is opened again whenever it is cut.
 *
 *     const robot = new Client({ url: "http://127.0.0.1:8080", token });
 *     await robot.connect();
 *     const { value } = await robot.read("/sensor/pose");
 */
export class Client<T extends Catalogue = Untyped> {
  readonly session: Session;
  #watchers = { change: new Set<() => void>(), notice: new Set<(notice: Notice) => void>() };
  #leases = new Set<Lease>();

  constructor(options: SessionOptions) {
    this.session = new Session(options);
    this.session.onchange = () => this.#watchers.change.forEach((told) => told());
    this.session.onnotice = (notice) => {
      if (notice.code === "lease_lost") this.#loseLeases(notice);
      this.#watchers.notice.forEach((told) => told(notice));
    };
    this.session.onfresh = () => this.#loseLeases(undefined);
  }

  get state(): State {
    return this.session.state;
  }

  get hello(): Hello | undefined {
    return this.session.hello;
  }

  get clock(): Clock {
    return this.session.clock;
  }

  /** Connect; rejects if the gateway refuses who asks. It is tried on and on while it cannot be reached. */
  connect(): Promise<Hello> {
    return new Promise((resolve, reject) => {
      const stop = this.onChange(() => {
        const { state, hello, problem } = this.session;
        if (state === "open" && hello) resolve(hello);
        else if (state === "refused" || state === "closed") reject(problem);
        else return;
        stop();
      });
      this.session.start();
    });
  }

  /** Leave. The gateway keeps the session for a while, and what it runs. */
  close(): void {
    this.#loseLeases(undefined); // while what they bring about can still be sent
    this.session.close();
  }

  /** Be called at each change of the connection, its latency included; returns what ends it. */
  onChange(told: () => void): () => void {
    this.#watchers.change.add(told);
    return () => this.#watchers.change.delete(told);
  }

  onNotice(told: (notice: Notice) => void): () => void {
    this.#watchers.notice.add(told);
    return () => this.#watchers.notice.delete(told);
  }

  async #ask(request: Request): Promise<Reply> {
    const reply = await this.session.ask(request);
    if (reply.error) throw new RcpError(reply.error);
    return reply;
  }

  /** Read a value; of a pattern the list of all items, however many pages they fill. */
  async read<P extends Paths<T["values"]>>(path: P, options: ReadOptions = {}): Promise<Reading<Of<T["values"], P>>> {
    let whole: Reply | undefined;
    for await (const reply of this.#pages(path, options)) {
      if (whole) whole.body = [...whole.body, ...reply.body];
      else whole = reply;
    }
    const { body, seq, source_timestamp, state } = whole as Reply;
    return { value: body, seq, timestamp: source_timestamp, state };
  }

  /** Read a pattern page by page, each of at most `limit` items (1000). */
  async *pages(pattern: string, options: ReadOptions & { limit?: number } = {}): AsyncGenerator<Item[]> {
    for await (const reply of this.#pages(pattern, options)) yield reply.body as Item[];
  }

  /** Ask for one page after the other; `deadline` is for all of them together. */
  async *#pages(path: string, options: ReadOptions & { limit?: number }): AsyncGenerator<Reply> {
    const { deadline, ...asked } = options;
    const end = deadline === undefined ? undefined : Date.now() + deadline * 1000;
    let cursor: string | undefined;
    do {
      const left = end === undefined ? {} : { deadline: Math.max((end - Date.now()) / 1000, 0.001) };
      const body = { ...asked, ...(cursor !== undefined && { cursor }) };
      const reply = await this.#ask({ type: "read", path, body, ...left });
      yield reply;
      cursor = reply.cursor;
    } while (cursor !== undefined);
  }

  /** Write a value; returns the one now in force. */
  async write<P extends Paths<T["writes"]>>(path: P, value: Of<T["writes"], P>, options: WriteOptions = {}): Promise<any> {
    const valid = options.validFor === undefined ? {} : { valid_for: options.validFor };
    return (await this.#ask({ type: "write", path, body: value, ...valid, ...this.#command(options) })).body;
  }

  /** Write several paths of one robot as one, all or none: those of one `atomic` group. Returns the values now in force. */
  async writeAll<P extends Paths<T["writes"]>>(
    values: { [K in P]: Of<T["writes"], K> },
    options: WriteOptions = {},
  ): Promise<Record<P, any>> {
    const valid = options.validFor === undefined ? {} : { valid_for: options.validFor };
    const reply = await this.#ask({ type: "write", body: values, ...valid, ...this.#command(options) });
    const items = reply.body as { body?: any }[];
    const facts = items.map((item) => (options.dryRun ? item : item.body));
    return Object.fromEntries(Object.keys(values).map((path, number) => [path, facts[number]])) as Record<P, any>;
  }

  execute<P extends Paths<T["commands"]>>(
    path: P,
    input?: Part<T["commands"], P, "input">,
    options: CommandOptions = {},
  ): Command<Part<T["commands"], P, "output">, Part<T["commands"], P, "feedback">> {
    const command = new Command(path, async (one) => {
      if (!this.session.withdraw(id)) await this.cancel(one.id === undefined ? { path } : one.id);
    });
    const id = this.session.run({ type: "execute", path, body: input ?? null, ...this.#command(options) }, command);
    return command;
  }

  /**
   * Run several operations as one plan, which the gateway checks first: steps, a whole body, or a text (JSON, what a
   * planner put out, lines of commands). A refusal has all faults in `details.faults`. Cancelling it stops its steps.
   */
  plan(plan: string | readonly Step[] | PlanBody, options: Omit<CommandOptions, "dryRun"> = {}): Plan {
    let id = "";
    const running = new Plan(PLANS, async (one) => {
      if (!this.session.withdraw(id)) await this.cancel(await one.accepted);
    });
    try {
      id = this.session.run({ type: "execute", path: PLANS, body: planOf(plan), ...this.#command(options) }, running);
    } catch (problem) {
      const { code, message, remedy } = problem as RcpError;
      running.take({ type: "execute", status: "rejected", error: { code, message, remedy, origin: "client" } });
    }
    return running;
  }

  /** Check a plan as `plan` would, without starting anything; returns the requests that it would send. */
  async validatePlan(plan: string | readonly Step[] | PlanBody, options: { deadline?: number } = {}): Promise<PlannedStep[]> {
    const checked = { ...options, dryRun: true };
    const body = planOf(plan);
    return (await this.#ask({ type: "execute", path: PLANS, body, ...this.#command(checked) })).body.steps as PlannedStep[];
  }

  #command(options: CommandOptions): Partial<Request> {
    return {
      ...(options.dryRun && { dry_run: true }),
      ...(options.deadline !== undefined && { deadline: options.deadline }),
      ...(options.idempotencyKey !== undefined && { idempotency_key: options.idempotencyKey }),
      ...(options.approval !== undefined && { approval: options.approval }),
    };
  }

  /** Cancel a command by its id, or whatever runs on a path; returns the ids of those that were told. */
  async cancel(what: string | { path: string }): Promise<string[]> {
    const which = typeof what === "string" ? { command: what } : what;
    return ((await this.#ask({ type: "cancel", ...which })).body as { cancelled: string[] }).cancelled;
  }

  /** Subscribe to paths or patterns. It stands through cuts; `ended` tells if it does not. */
  subscribe<P extends Paths<T["values"]>>(
    paths: P | P[],
    options: SubscribeOptions,
    handlers: Handlers<Of<T["values"], P>>,
  ): Subscription<Of<T["values"], P>> {
    const id = this.session.newId("s");
    const made = new Subscription(id, [paths].flat(), options, handlers, async (one) => {
      this.session.subscriptions.delete(one.id);
      await this.session.unsubscribe(one.id);
    });
    this.session.subscriptions.set(id, made);
    // What is refused is told by `ended`, what cannot be sent now is sent with the next session.
    this.session.subscribe(made).catch(() => undefined);
    return made;
  }

  /** Yield the samples of paths or patterns until the loop is left, the newest where it is too slow. */
  async *watch<P extends Paths<T["values"]>>(
    paths: P | P[],
    options: SubscribeOptions = {},
  ): AsyncGenerator<Update<Of<T["values"], P>>> {
    const newest = new Map<string, Update>();
    let wake: (() => void) | undefined;
    let over: { error: RcpError | undefined } | undefined;
    const subscription = this.subscribe(paths, options, {
      update: (update) => {
        newest.set(update.path, update);
        wake?.();
      },
      ended: (error) => {
        over = { error };
        wake?.();
      },
    });
    try {
      for (;;) {
        for (const [path, update] of [...newest]) {
          newest.delete(path);
          yield update;
        }
        if (newest.size > 0) continue;
        if (over?.error) throw over.error;
        if (over) return;
        await new Promise<void>((resolve) => (wake = resolve));
      }
    } finally {
      await subscription.close();
    }
  }

  /** One page of the catalogue. */
  async discover(pattern?: string, options: DiscoverOptions = {}): Promise<Discovered> {
    const path = pattern === undefined ? {} : { path: pattern };
    return (await this.#ask({ type: "discover", ...path, body: options })).body as Discovered;
  }

  /** The catalogue, page by page to its end. */
  async discoverAll(pattern?: string, options: DiscoverOptions = {}): Promise<Resource[]> {
    const found: Resource[] = [];
    let cursor: string | undefined;
    do {
      const page = await this.discover(pattern, { limit: 1000, ...options, ...(cursor !== undefined && { cursor }) });
      found.push(...page.resources);
      cursor = page.cursor;
    } while (cursor !== undefined);
    return found;
  }

  /** Hold a scope exclusively, renewed by itself; `lost` is called once if it is taken away. */
  async lease(
    scope: string,
    options: { ttl?: number; take?: boolean; reason?: string; lost?: (notice: Notice | undefined) => void } = {},
  ): Promise<Lease> {
    const { lost, ttl = LEASE, ...how } = options;
    const ask = async (input: Record<string, unknown>): Promise<LeaseState> =>
      (await this.#ask({ type: "execute", path: "/system/leases", body: input })).body as LeaseState;
    const state = await ask({ do: "acquire", scope, ttl, ...how });
    const lease: Lease = new Lease(state, ttl, ask, {
      ended: (one) => this.#leases.delete(one),
      lost: (notice) => lost?.(notice),
    });
    this.#leases.add(lease);
    return lease;
  }

  #loseLeases(notice: Notice | undefined): void {
    for (const lease of [...this.#leases]) {
      if (notice !== undefined && notice["lease"] !== lease.state.lease) continue;
      this.#leases.delete(lease);
      lease.lose(notice);
    }
  }

  /**
   * Stop every robot in scope (a robot, a group, a backend or a tenant), or all that may be seen.
   *
   * Resolves when all of them are confirmed at rest. Rejects with `device_timeout` when one is not within `deadline`
   * seconds; `details.robots` says which and why. They stay latched all the same, and the stop is repeated.
   */
  async estop(options: { scope?: string; reason?: string; deadline?: number } = {}): Promise<EstopState> {
    const { deadline = ESTOP, ...body } = options;
    return (await this.#ask({ type: "execute", path: "/system/estop", body, deadline })).body;
  }

  /**
   * Bring a robot to rest and end its commands, without an e-stop: the next command moves it again.
   *
   * `robot` is its name in the own tenant, or `/tenant/<tenant>/<robot>`; not needed where the tenant has one robot
   * without a name. Rejects with `device_timeout` when it still moves.
   */
  async hold(robot?: string, options: { deadline?: number } = {}): Promise<Held> {
    const path = holdOf(robot) as Paths<T["commands"]>;
    return (await this.execute(path, undefined, options).result) as Held;
  }

  /** Let commands through again; nothing moves until a new one. */
  async resetEstop(options: { scope?: string; reason?: string; dryRun?: boolean } = {}): Promise<EstopState> {
    const { dryRun, ...body } = options;
    const request: Request = { type: "execute", path: "/system/estop", body: { ...body, reset: true } };
    return (await this.#ask({ ...request, ...(dryRun && { dry_run: true }) })).body;
  }
}
