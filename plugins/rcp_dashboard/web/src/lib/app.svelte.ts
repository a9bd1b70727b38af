import { Client, ConnectionLost, type EstopState, type Hello, type LeaseState, RcpError, type Resource, type State } from "rcp-client";

import type { Approval } from "./approvals.ts";
import { msgpack } from "rcp-client/msgpack";

import { forget, keep, kept } from "./kept.ts";
import { robotsOf } from "./robots.ts";
import { onWake } from "./wake.ts";

const TOKEN = "rcp.token";
const REFRESH = 5000; // ms between looks at whether the tree has changed
const SLACK = 5000; // ms that two tellings of when the gateway began may differ by
const HUNG = 1000; // ms that an emergency stop has by the WebSocket alone
const LATER = 3000; // ms after which it is sent by HTTP once more
const PATIENCE = 12_000; // ms that an answer by HTTP may take

type Taken = "status" | "estop" | "leases" | "approvals";

/** Where the gateway is: the page stands at its root, below any path prefix. */
export const BASE = new URL(".", document.baseURI).href.replace(/\/$/, "");

/** What the pages share: who is logged in, the connection, the tree, health and e-stop. */
class App {
  client = $state.raw(this.#make());
  state = $state<State>("connecting");
  hello = $state.raw<Hello>();
  problem = $state.raw<RcpError>();
  latency = $state<number>();
  resources = $state.raw<Resource[]>([]);
  /** Whether the tree was asked for and came. */
  known = $state(false);
  status = $state.raw<any>();
  estop = $state.raw<EstopState>();
  leases = $state.raw<LeaseState[]>([]);
  /** What waits for a person, or did: what this role may decide on, and its own. */
  approvals = $state.raw<Approval[]>([]);
  mayReset = $state(false);
  /** Rises with each login, so that what was made for the old one is made anew. */
  epoch = $state(0);
  byPath = $derived(new Map(this.resources.map((one) => [one.path, one])));
  /** How each robot's backend is, by name; it changes every second, and `robots` only with the tree. */
  health = $derived(new Map<string, any>((this.status?.backends ?? []).map((one: any) => [one.name, one])));
  #backends = $derived(JSON.stringify((this.status?.backends ?? []).map((one: any) => [one.name, one.tenant])));
  robots = $derived(robotsOf(this.resources, JSON.parse(this.#backends)));
  /** When the gateway was last heard, in ms since the epoch, where the connection is lost. */
  heard = $state<number>();
  #generation = -1;
  #timer: ReturnType<typeof setInterval> | undefined;
  /** What the gateway did not let this page follow, to be tried again when it may. */
  #refused = new Set<Taken>();
  /** When the gateway began, as its status tells, in ms since the epoch. */
  #began: number | undefined;

  constructor() {
    onWake(() => this.client.session.check());
  }

  /** Whether a gateway that serves nobody without a token has let the page no further than its door. */
  outside = $derived(this.state === "refused" || this.hello?.principal === "nobody");

  get token(): string | null {
    return kept(TOKEN);
  }

  #make(): Client {
    const token = this.token;
    return new Client({ url: BASE, name: "dashboard", ping: 2, codec: msgpack, encoding: "json", ...(token && { token }) });
  }

  /** Connect with the token that is kept, or as nobody. */
  start(): void {
    const client = this.client;
    client.onChange(() => {
      if (client === this.client) this.#changed();
    });
    client.connect().catch(() => undefined); // told by the state
    this.#refused.clear();
    for (const part of ["status", "estop", "leases", "approvals"] as const) this.#follow(client, part);
    clearInterval(this.#timer);
    this.#timer = setInterval(() => void this.#look(), REFRESH);
  }

  #follow(client: Client, part: Taken): void {
    client.subscribe(`/system/${part}`, {}, {
      update: ({ body, timestamp }) => {
        if (client !== this.client) return;
        this[part] = body;
        if (part === "status") this.#checkRun(Date.parse(timestamp) - body.uptime * 1000);
      },
      ended: () => {
        if (client !== this.client) return;
        this.#refused.add(part);
        this.#empty(part);
      },
    });
  }

  #empty(part: Taken): void {
    if (part === "status" || part === "estop") this[part] = undefined;
    else this[part] = [];
  }

  /** Begin anew where another gateway answers now: what pages hold is of one that is gone. */
  #checkRun(began: number): void {
    if (this.#began !== undefined && Math.abs(began - this.#began) > SLACK) this.epoch += 1;
    this.#began = began;
  }

  #changed(): void {
    const { state, hello, session } = this.client;
    const opened = state === "open" && this.state !== "open";
    this.state = state;
    this.problem = session.problem;
    this.latency = session.latency;
    if (state !== "open") this.heard = session.heard ?? this.heard;
    if (opened && hello && this.hello) this.#compare(this.hello, hello);
    if (hello) this.hello = hello;
    if (opened) void this.#look(true);
  }

  /** Forget what the last session had, where this one is not it. */
  #compare(before: Hello, now: Hello): void {
    if (now.session === before.session) return;
    this.#generation = -1;
    this.mayReset = false;
    for (const part of ["leases", "approvals"] as const) this.#empty(part);
    const rights = ({ principal, roles, tenants }: Hello): string => JSON.stringify([principal, roles, tenants]);
    if (this.#began === undefined || rights(now) !== rights(before)) this.epoch += 1;
  }

  /** Ask for the tree if it is not the one that is known. */
  async #look(anew = false): Promise<void> {
    const client = this.client;
    if (client.state !== "open") return;
    try {
      const { generation } = await client.discover("/**", { limit: 1, schemas: false });
      if (generation !== this.#generation || anew) {
        const resources = await client.discoverAll("/**");
        if (client !== this.client) return;
        this.resources = resources;
        this.known = true;
        this.#generation = generation;
        const greeted = (await client.session.ask({ type: "hello" })).body as Partial<Hello> | undefined;
        if (greeted?.roles && this.hello) this.hello = { ...this.hello, ...greeted, resume_token: this.hello.resume_token };
        anew = true; // who may do something else may reset something else
      }
      for (const part of this.#refused) if (this.may(`/system/${part}`, "subscribe") && this.#refused.delete(part)) this.#follow(client, part);
      if (anew) {
        this.mayReset = await client.resetEstop({ dryRun: true }).then(() => true, () => false);
      }
    } catch {
      // The connection was cut meanwhile: it is looked at again with the next one.
    }
  }

  /** Log in with a token, or out without one; `remember` keeps it on this computer. */
  login(token: string | undefined, remember = false): void {
    forget(TOKEN);
    if (token) keep(TOKEN, token, remember ? "computer" : "tab");
    this.client.close();
    this.hello = this.problem = this.status = this.estop = undefined;
    this.resources = [];
    this.leases = [];
    this.approvals = [];
    this.known = this.mayReset = false;
    this.#generation = -1;
    this.#began = undefined;
    this.client = this.#make();
    this.epoch += 1;
    this.start();
  }

  /** Stop everything in scope; by HTTP, too, where the WebSocket is not there to do it or hangs. */
  async stop(scope?: string): Promise<void> {
    const input = { reason: "stopped on the dashboard", ...(scope && { scope }) };
    const { client } = this;
    if (client.state !== "open") return this.#stopByHttp(input);
    const told = client.estop(input);
    let timer: ReturnType<typeof setTimeout> | undefined;
    const hung = new Promise((resolve) => (timer = setTimeout(resolve, HUNG)));
    try {
      await Promise.any([told, hung.then(() => this.#stopByHttp(input))]);
    } catch {
      await told; // what it was refused with is said
    } finally {
      clearTimeout(timer);
    }
  }

  async #stopByHttp(input: Record<string, unknown>): Promise<void> {
    const headers: Record<string, string> = { "content-type": "application/json" };
    if (this.token) headers["authorization"] = `Bearer ${this.token}`;
    const body = JSON.stringify({ type: "execute", path: "/system/estop", body: input });
    const lost = (): never => {
      throw new ConnectionLost("the gateway does not answer: nothing may have stopped", "Use the stop on the robot.");
    };
    const send = (): Promise<Response> => fetch(`${BASE}/rcp/v1/messages`, { method: "POST", headers, body, signal: AbortSignal.timeout(PATIENCE) });
    // The first may have gone into a connection that the browser has kept, and that is dead as well.
    let timer: ReturnType<typeof setTimeout> | undefined;
    const again = new Promise<void>((go) => (timer = setTimeout(go, LATER))).then(send);
    const answer = await Promise.any([send(), again]).catch(lost);
    clearTimeout(timer); // a second one would undo the reset that may have followed the first
    const reply = await answer.json().catch(lost);
    if (reply.error) throw new RcpError(reply.error);
  }

  may(path: string, operation: "read" | "write" | "execute" | "subscribe"): boolean {
    return this.byPath.get(path)?.operations.includes(operation) ?? false;
  }
}

export const app = new App();
