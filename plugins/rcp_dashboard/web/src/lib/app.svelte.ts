import { Client, type EstopState, type Hello, type LeaseState, RcpError, type Resource, type State } from "rcp-client";

import type { Approval } from "./approvals.ts";
import { msgpack } from "rcp-client/msgpack";

import { robotsOf } from "./robots.ts";

const TOKEN = "rcp.token";
const REFRESH = 5000; // ms between looks at whether the tree has changed

const HUNG = 1000; // ms that an emergency stop has by the WebSocket alone

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
  #generation = -1;
  #timer: ReturnType<typeof setInterval> | undefined;

  /** Whether a gateway that serves nobody without a token has let the page no further than its door. */
  outside = $derived(this.state === "refused" || this.hello?.principal === "nobody");

  get token(): string | null {
    return sessionStorage.getItem(TOKEN) ?? localStorage.getItem(TOKEN);
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
    client.subscribe("/system/status", {}, { update: (update) => (this.status = update.body) });
    client.subscribe("/system/estop", {}, { update: (update) => (this.estop = update.body) });
    client.subscribe("/system/leases", {}, { update: (update) => (this.leases = update.body) });
    client.subscribe("/system/approvals", {}, { update: (update) => (this.approvals = update.body) });
    clearInterval(this.#timer);
    this.#timer = setInterval(() => void this.#look(), REFRESH);
  }

  #changed(): void {
    const { state, hello, session } = this.client;
    const opened = state === "open" && this.state !== "open";
    this.state = state;
    this.problem = session.problem;
    this.latency = session.latency;
    if (hello) this.hello = hello;
    if (opened) void this.#look(true);
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
      }
      if (anew) {
        this.mayReset = await client.resetEstop({ dryRun: true }).then(() => true, () => false);
      }
    } catch {
      // The connection was cut meanwhile: it is looked at again with the next one.
    }
  }

  /** Log in with a token, or out without one; `keep` remembers it on this computer. */
  login(token: string | undefined, keep = false): void {
    sessionStorage.removeItem(TOKEN);
    localStorage.removeItem(TOKEN);
    if (token) (keep ? localStorage : sessionStorage).setItem(TOKEN, token);
    this.client.close();
    this.hello = this.problem = this.status = this.estop = undefined;
    this.resources = [];
    this.leases = [];
    this.approvals = [];
    this.known = this.mayReset = false;
    this.#generation = -1;
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
    const answer = await fetch(`${BASE}/rcp/v1/messages`, { method: "POST", headers, body });
    const reply = await answer.json();
    if (reply.error) throw new RcpError(reply.error);
  }

  may(path: string, operation: "read" | "write" | "execute" | "subscribe"): boolean {
    return this.byPath.get(path)?.operations.includes(operation) ?? false;
  }
}

export const app = new App();
