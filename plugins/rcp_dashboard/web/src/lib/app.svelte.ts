import { Client, ConnectionLost, type EstopState, type Hello, type LeaseState, RcpError, type Resource, type State } from "rcp-client";

import type { Approval } from "./approvals.ts";
import { msgpack } from "rcp-client/msgpack";

import { forget, keep, kept } from "./kept.ts";
import { beginLogin, endLogin, type IssuerLink, isLoggedIn, loginAt } from "./login.ts";
import { robotsOf } from "./robots.ts";
import { latchedOf } from "./stops.ts";
import { Tabs } from "./tabs.ts";
import { onWake } from "./wake.ts";

const TOKEN = "rcp.token";
const REFRESH = 5000; // ms between looks at whether the tree has changed
const SLACK = 5000; // ms that two tellings of when the gateway began may differ by
const HUNG = 1000; // ms that an emergency stop has by the WebSocket alone
const LATER = 3000; // ms after which it is sent by HTTP once more
const ALARMS = 50; // that are kept
const TENANTS = 50; // that are asked for one by one, where not all may be reset at once
const CONFIRM = 2; // s that an answer by HTTP waits for robots to come to rest: less than `LATER`
const PATIENCE = 12_000; // ms that an answer by HTTP may take

/** A robot that moved again under an emergency stop. */
export interface Alarm {
  name: string;
  detail: string;
  timestamp: string;
}

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
  /** Every robot under an emergency stop, with how far it has come. */
  latched = $derived(latchedOf(this.estop));
  /** Robots that moved again under a stop, since this page is open. */
  alarms = $state.raw<Alarm[]>([]);
  #alarmed = new Set<string>();
  /** Whether this role may reset every stop it can see. */
  mayReset = $state(false);
  /** Tenants in which it may, where it may not in all. */
  #resets = $state.raw<ReadonlySet<string>>(new Set());
  /** The robots that a stop without a scope stops; null where this role has to name one, undefined while that is not known. */
  reach = $state.raw<string[] | null>();
  /** Stops and holds that are on their way: nobody drives meanwhile. */
  stopping = $state(0);
  holding = $state(0);
  /** Why a stop did not go through. */
  stopProblem = $state.raw<RcpError>();
  /** Rises with each login, so that what was made for the old one is made anew. */
  epoch = $state(0);
  byPath = $derived(new Map(this.resources.map((one) => [one.path, one])));
  /** How each robot's backend is, by name; it changes every second, and `robots` only with the tree. */
  health = $derived(new Map<string, any>((this.status?.backends ?? []).map((one: any) => [one.name, one])));
  #backends = $derived(JSON.stringify((this.status?.backends ?? []).map((one: any) => [one.name, one.tenant, one.robot])));
  robots = $derived(robotsOf(this.resources, JSON.parse(this.#backends)));
  /** When the gateway was last heard, in ms since the epoch, where the connection is lost. */
  heard = $state<number>();
  #generation = -1;
  #timer: ReturnType<typeof setInterval> | undefined;
  /** What the gateway did not let this page follow, to be tried again when it may. */
  #refused = new Set<Taken>();
  /** When the gateway began, as its status tells, in ms since the epoch. */
  #began: number | undefined;

  /** Whether this page goes by the login that the gateway keeps for the browser. */
  #cookie = false;
  /** Whether the gateway did not answer when it was to end the login. */
  stillLoggedIn = $state(false);
  /** Where the person who has just logged out here is still logged in, and logs out. */
  logOutAt = $state.raw<IssuerLink>();
  readonly #tabs = new Tabs(BASE, () => this.token, () => this.#cookie, () => this.#change(undefined));

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

  /** Connect with the token that is kept here, by the cookie, with the token that another tab has, or as nobody. */
  async open(): Promise<void> {
    this.#cookie = this.token === null && (await isLoggedIn(BASE));
    const found = this.token === null && !this.#cookie ? await this.#tabs.token() : undefined;
    if (found !== undefined) {
      keep(TOKEN, found, "tab");
      this.client = this.#make();
    }
    this.start();
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
        if (part === "estop") this.#noteAlarms(timestamp);
        if (part === "status") this.#checkRun(Date.parse(timestamp) - body.uptime * 1000);
      },
      ended: () => {
        if (client !== this.client) return;
        this.#refused.add(part);
        this.#empty(part);
      },
    });
  }

  #noteAlarms(timestamp: string): void {
    const now = this.latched.filter((one) => one.phase === "alarm");
    const fresh = now.filter((one) => !this.#alarmed.has(one.name)).map(({ name, detail }) => ({ name, detail, timestamp }));
    this.#alarmed = new Set(now.map((one) => one.name));
    if (fresh.length) this.alarms = [...this.alarms, ...fresh].slice(-ALARMS);
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
    this.#resets = new Set();
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
        await this.#lookAtReach(client);
      }
      for (const part of this.#refused) if (this.may(`/system/${part}`, "subscribe") && this.#refused.delete(part)) this.#follow(client, part);
      if (anew) await this.#lookAtRights(client);
    } catch {
      // The connection was cut meanwhile: it is looked at again with the next one.
    }
  }

  async #lookAtRights(client: Client): Promise<void> {
    const may = (scope?: string): Promise<boolean> => client.resetEstop({ dryRun: true, ...(scope && { scope }) }).then(() => true, () => false);
    const all = await may();
    const resets = new Set<string>();
    if (!all) for (const tenant of (this.hello?.tenants ?? []).slice(0, TENANTS)) if (await may(`/tenant/${tenant}`)) resets.add(tenant);
    if (client !== this.client) return;
    this.mayReset = all;
    this.#resets = resets;
  }

  /** Ask what a stop without a scope would stop, for the button to say so. */
  async #lookAtReach(client: Client): Promise<void> {
    const ask = client.session.ask({ type: "execute", path: "/system/estop", body: {}, dry_run: true });
    const reach = await ask.then(
      ({ body }) => (body as { robots?: string[] }).robots,
      (error: RcpError) => (error.code === "forbidden" ? null : undefined),
    );
    if (client === this.client) this.reach = reach;
  }

  /** Whether this role may reset a stop of a tenant's robots. */
  mayResetIn(tenant: string | undefined): boolean {
    return this.mayReset || (tenant !== undefined && this.#resets.has(tenant));
  }

  /**
   * Log in with a token; `remember` keeps the login when the browser is closed. The token is kept only where the gateway keeps no login.
   *
   * Rejects with an `RcpError` where the gateway does not take it; who was logged in before still is.
   */
  async logIn(token: string, remember: boolean): Promise<void> {
    const cookie = await beginLogin(BASE, token, remember);
    this.#change(cookie ? undefined : token, remember, cookie);
  }

  /** Go to log in at an issuer. A token that is kept would go before the cookie with which the browser comes back. */
  goTo(issuer: IssuerLink, remember: boolean): void {
    forget(TOKEN);
    location.assign(loginAt(issuer, location.hash, remember));
  }

  /** Log out, in all tabs: of the token, and of the cookie, which another tab may have got unknown to this one. */
  async logOut(): Promise<void> {
    const token = this.token ?? undefined;
    if (token !== undefined) {
      forget(TOKEN); // at once: it takes no answer of the gateway
      this.#tabs.logOut(token);
    }
    const { ended, logOutAt } = await endLogin(BASE);
    if (ended) this.#tabs.logOut();
    const still = !ended && (this.#cookie || token === undefined);
    if (!still || token !== undefined) this.#change(undefined, false, still);
    this.stillLoggedIn = still;
    this.logOutAt = logOutAt;
  }

  #change(token: string | undefined, remember = false, cookie = false): void {
    this.#cookie = cookie;
    this.stillLoggedIn = false;
    this.logOutAt = undefined;
    forget(TOKEN);
    if (token) keep(TOKEN, token, remember ? "computer" : "tab");
    this.client.close();
    this.hello = this.problem = this.status = this.estop = undefined;
    this.resources = [];
    this.leases = [];
    this.approvals = [];
    this.known = this.mayReset = false;
    this.#resets = new Set();
    this.stopProblem = this.reach = undefined;
    this.alarms = [];
    this.#alarmed.clear();
    this.#generation = -1;
    this.#began = undefined;
    this.client = this.#make();
    this.epoch += 1;
    this.start();
  }

  /** Stop everything in scope, or all there is; what keeps it from going through is shown above every page. */
  async stop(scope?: string): Promise<void> {
    this.stopping += 1;
    this.stopProblem = undefined;
    try {
      await this.#sendStop(scope);
    } catch (problem) {
      const error = problem as RcpError;
      // Latched, and not confirmed by all: the banner says by whom not, for as long as that is so.
      if (error.code !== "device_timeout" || !this.estop?.active) this.stopProblem = error;
    } finally {
      this.stopping -= 1;
    }
  }

  /** By HTTP, too, where the WebSocket is not there to do it or hangs. */
  async #sendStop(scope?: string): Promise<void> {
    const input = { reason: "stopped on the dashboard", ...(scope && { scope }) };
    const { client } = this;
    if (client.state !== "open") return this.#stopByHttp(input);
    const told = client.estop(input);
    // What comes back of a ping behind it tells that it got there: robots may take longer to come to rest.
    let arrived = false;
    const ping = client.session.ask({ type: "ping" });
    ping.then(
      () => (arrived = true),
      (error: RcpError) => (arrived = error.code !== "connection_lost"),
    );
    let timer: ReturnType<typeof setTimeout> | undefined;
    const hung = new Promise<void>((resolve) => {
      timer = setTimeout(resolve, HUNG);
      told.catch((error: RcpError) => error.code === "connection_lost" && resolve());
    });
    try {
      await Promise.any<unknown>([told, hung.then<unknown>(() => (arrived ? told : this.#stopByHttp(input)))]);
    } catch {
      await told; // what it was refused with is said
    } finally {
      clearTimeout(timer);
    }
  }

  async #stopByHttp(input: Record<string, unknown>): Promise<void> {
    const headers: Record<string, string> = { "content-type": "application/json" };
    if (this.token) headers["authorization"] = `Bearer ${this.token}`;
    const body = JSON.stringify({ type: "execute", path: "/system/estop", body: input, deadline: CONFIRM });
    const lost = (): never => {
      throw new ConnectionLost("no response from the gateway: robots may not have stopped", "Use the robot's own emergency stop.");
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
