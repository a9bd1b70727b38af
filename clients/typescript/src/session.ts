import { Addresses } from "./addresses.ts";
import { Clock, Moment, steady } from "./clock.ts";
import type { Command } from "./command.ts";
import { acts, ConnectionLost, RcpError, repeatable, stops, unanswered, withheld } from "./errors.ts";
import { Backoff, Link, type Incoming } from "./link.ts";
import { keyed, notYet, repeatOf } from "./repeats.ts";
import type { Subscription } from "./subscription.ts";
import { type Codec, type Discovered, FINAL, type Hello, type Notice, type Reply, type Request, type Update } from "./wire.ts";

export type State = "connecting" | "open" | "waiting" | "refused" | "closed";

export interface SessionOptions {
  /**
   * The gateway, as http(s) or ws(s), with a path prefix where it stands behind one. Several with commas between them are
   * those of one gateway, or of the hubs of a fleet: the next is tried when one is lost.
   */
  url: string;
  token?: string;
  tenant?: string;
  /** Name and version, for the operator of the gateway. */
  name?: string;
  /** Seconds between round trips that measure latency and clock. */
  ping?: number;
  /** What it can read and write beside JSON: `msgpack` of `rcp-client/msgpack`. */
  codec?: Codec;
  /** What the connection is to be: the codec's, if there is one; JSON where the gateway does not speak that. */
  encoding?: "json" | "msgpack";
}

interface Waiting {
  request: Request & { id: string };
  made: Moment;
  take: (reply: Reply) => boolean;
  lose: (error: RcpError) => void;
  /** Whether it may be asked again although it was sent. */
  repeatable: boolean;
  /** Whether it was sent over a connection that was cut since. */
  cut: boolean;
  /** Whether the gateway has answered: what becomes of it is told for as long as the session lasts. */
  answered: boolean;
}

type Asked = Omit<Waiting, "made" | "repeatable" | "request">;

/** A command whose age cannot be told until the next round trip. */
interface Held {
  request: Request & { id: string };
  asked: Asked;
  made: Moment;
  timer: ReturnType<typeof setTimeout>;
}

const MOVES = new Set(["read", "discover", "status", "write", "execute"]);
const DEADLINE = 10; // s, the gateway's own default
const GRACE = 2; // s beyond a deadline before the answer is given up here
const SETTLE = 3000; // ms after a resume until what has no answer counts as lost on the way
const SILENCE = 6000; // ms without any answer after which a connection is dead
const OPENING = 10_000; // ms that a connection may take to stand, the greeting included
const AGAIN = 1000; // ms until a hub that does not reach a robot yet is asked again
const PROMPT = 100; // ms of a round trip that tells the time: by half of a longer one, commands would seem too young
const NO_TIME = "no round trip within its deadline, after this machine slept or its clock was set";
const CANCELLED = "it was cancelled";
const REFUSALS = new Set(["unauthenticated", "token_expired", "forbidden", "version_unsupported"]);

/** Seconds that a held command has until it is too old. */
function patience({ deadline = DEADLINE }: Request): number {
  return deadline;
}

/** What a client holds at the gateway, over as many connections as it takes. */
export class Session {
  state: State = "connecting";
  hello: Hello | undefined;
  /** Why there is no connection. */
  problem: RcpError | undefined;
  readonly clock = new Clock();
  readonly subscriptions = new Map<string, Subscription>();
  /** Call back with each notice, and when the state or the latency changes. */
  onnotice: ((notice: Notice) => void) | undefined;
  onchange: (() => void) | undefined;
  /** Call back when the session is a new one, so that nothing of an earlier one stands. */
  onfresh: (() => void) | undefined;
  #options: SessionOptions;
  #addresses: Addresses;
  #link: Link | undefined;
  #backoff = new Backoff();
  #retry: ReturnType<typeof setTimeout> | undefined;
  #settling: ReturnType<typeof setTimeout> | undefined;
  #pinging: ReturnType<typeof setInterval> | undefined;
  #waiting = new Map<string, Waiting>();
  /** In the order in which they were made. */
  #held: Held[] = [];
  /** Subscriptions that are wanted no more, which the gateway has not been told yet. */
  #orphans = new Set<string>();
  #names = 0;
  #heard = new Moment();
  /** When the first ping was sent of those that have no answer. */
  #pinged: Moment | undefined;
  #opening: ReturnType<typeof setTimeout> | undefined;

  constructor(options: SessionOptions) {
    this.#options = options;
    this.#addresses = new Addresses(options.url);
  }

  get token(): string | undefined {
    return this.#options.token;
  }

  /** Seconds of the last round trip, or those that the next one has taken so far if these are more; undefined without a connection. */
  get latency(): number | undefined {
    const { latency } = this.clock;
    return latency === undefined || this.#pinged === undefined ? latency : Math.max(latency, this.#pinged.passed / 1000);
  }

  /** Begin to connect; what comes of it is told by `onchange`. */
  start(): void {
    this.#open();
  }

  /** Leave: no connection, no further try. */
  close(): void {
    clearTimeout(this.#retry);
    clearTimeout(this.#opening);
    clearTimeout(this.#settling);
    clearInterval(this.#pinging);
    for (const subscription of this.subscriptions.values()) subscription.rest();
    this.#to("closed");
    this.#link?.close("the client was closed");
    this.#loseAll("the client was closed");
  }

  /** Try again now, and not when the waiting is over. */
  hurry(): void {
    if (this.state !== "waiting" && this.state !== "refused") return;
    clearTimeout(this.#retry);
    this.#backoff.reset();
    this.#open();
  }

  /** When the gateway was last heard, in ms since the epoch; undefined where it never was. */
  get heard(): number | undefined {
    return this.hello && this.#heard.wall;
  }

  /** Look whether the connection still stands: this machine may have slept, or have another network now. */
  check(): void {
    if (this.state === "open" && this.#heard.passed > SILENCE) this.#link?.close("nothing was heard for long");
    if (this.state === "waiting" && this.#link === undefined) this.hurry();
    if (!this.clock.known) this.#ping();
  }

  /** Cut the connection as a lost network would: the session goes on. */
  cut(): void {
    this.#link?.close("it was cut here");
  }

  newId(prefix: string): string {
    this.#names += 1;
    return `${prefix}-${this.#names}`;
  }

  /** Send a request and return its final reply, good or not. */
  ask(request: Request): Promise<Reply> {
    return new Promise((resolve, reject) => {
      const seconds = (request.deadline ?? DEADLINE) + GRACE;
      const id = request.id ?? this.newId("q");
      const timer = setTimeout(() => {
        this.#waiting.delete(id);
        reject(unanswered(request, seconds));
      }, seconds * 1000);
      if (request.type === "cancel" && request.path !== undefined) this.#withdrawFrom(this.#whole(request.path));
      this.#send({ ...request, id }, {
        take: (reply) => {
          if (!FINAL.has(reply.status)) return false;
          clearTimeout(timer);
          resolve(reply);
          return true;
        },
        lose: (error) => {
          clearTimeout(timer);
          reject(error);
        },
        cut: false,
        answered: false,
      });
    });
  }

  /** Send an execute whose replies go to `command`; returns the id of the request. */
  run(request: Request, command: Command): string {
    const id = this.newId("x");
    this.#send({ ...request, id }, {
      take: (reply) => command.take(reply),
      lose: (error) => command.lose(error),
      cut: false,
      answered: false,
    });
    return id;
  }

  /** Give up a command that is kept back, of which nothing was sent; false if there is none of this id. */
  withdraw(id: string): boolean {
    return this.#withdraw((request) => request.id === id, CANCELLED);
  }

  #send(request: Request & { id: string }, asked: Asked): void {
    if (this.state !== "open" || this.#link === undefined) {
      const why = this.problem?.message ?? "the connection is not open yet";
      asked.lose(new ConnectionLost(`not connected: ${why}`));
      return;
    }
    if (stops(request)) this.#withdraw(() => true, "a stop was made after it");
    if (acts(request) && (!this.clock.known || this.#held.length > 0)) return this.#hold(request, asked);
    // A stop has no time: it is never too old.
    const timed = (acts(request) || request.dry_run === true) && this.clock.known;
    const timestamp = timed ? { timestamp: new Date(this.clock.now()).toISOString() } : {};
    this.#transmit(this.#link, { ...request, ...timestamp }, asked, new Moment());
  }

  #transmit(link: Link, request: Request & { id: string }, asked: Asked, made: Moment): void {
    const sent = this.#addresses.several ? { ...keyed(request), id: request.id } : request;
    this.#waiting.set(request.id, { ...asked, request: sent, made, repeatable: repeatable(request) });
    link.send(sent);
  }

  /**
   * Keep a command back until a round trip, which begins at once: this machine slept, or its clock was set. Without the
   * gateway's time its age could not be checked, however long it waited in a connection that is half dead.
   */
  #hold(request: Request & { id: string }, asked: Asked): void {
    const timer = setTimeout(() => this.#withdraw(({ id }) => id === request.id, NO_TIME), patience(request) * 1000);
    this.#held.push({ request, asked, made: new Moment(), timer });
    if (this.#pinged === undefined || this.#pinged.torn) this.#ping();
  }

  /** Send what was held, as of when it was made; not what is older than its deadline. */
  #sendHeld(link: Link): void {
    for (const { request, asked, made, timer } of this.#held.splice(0)) {
      clearTimeout(timer);
      const age = made.passed / 1000;
      if (age >= patience(request)) {
        asked.lose(withheld(NO_TIME));
        continue;
      }
      const timestamp = new Date(this.clock.now() - made.passed).toISOString();
      const left = request.deadline === undefined ? {} : { deadline: request.deadline - age };
      this.#transmit(link, { ...request, timestamp, ...left }, asked, made);
    }
  }

  #withdrawFrom(whole: string): void {
    this.#withdraw(({ path }) => path !== undefined && this.#whole(path) === whole, CANCELLED);
  }

  /** A path as the gateway completes it. */
  #whole(path: string): string {
    const tenant = this.hello?.tenant ?? undefined;
    return tenant === undefined || /^\/(tenant|system)\//.test(path) ? path : `/tenant/${tenant}${path}`;
  }

  /** Give up held commands: nothing of them was sent. Returns whether there were any. */
  #withdraw(which: (request: Held["request"]) => boolean, why: string): boolean {
    const gone = this.#held.filter(({ request }) => which(request));
    this.#held = this.#held.filter((one) => !gone.includes(one));
    for (const { asked, timer } of gone) {
      clearTimeout(timer);
      asked.lose(withheld(why, why === NO_TIME ? "deadline_exceeded" : "cancelled"));
    }
    return gone.length > 0;
  }

  // -- the connection -----------------------------------------------------------------------

  #open(): void {
    this.#to(this.hello === undefined ? "connecting" : "waiting");
    const before = this.#link;
    this.#link = undefined;
    before?.close("another one is opened");
    const { codec, encoding = codec?.name ?? "json" } = this.#options;
    const link: Link = new Link(this.#addresses.current, { codec, preferred: encoding }, {
      open: () => {
        if (link === this.#link) void this.#greet(link, this.hello !== undefined);
      },
      message: (message) => {
        if (link === this.#link) this.#take(message);
      },
      closed: (why) => {
        if (link === this.#link) this.#lost(why);
      },
    });
    this.#link = link;
    clearTimeout(this.#opening);
    // What neither answers nor ends would be waited for for good: a network that swallows all, or a proxy that hangs.
    this.#opening = setTimeout(() => link.close("the gateway does not answer"), OPENING);
  }

  async #greet(link: Link, resuming: boolean): Promise<void> {
    const { token, tenant, name } = this.#options;
    const body: Record<string, unknown> = { client: name ?? "rcp-client-ts" };
    if (token !== undefined) body["token"] = token;
    if (tenant !== undefined) body["tenant"] = tenant;
    if (resuming && this.hello !== undefined) {
      body["session"] = this.hello.session;
      body["resume_token"] = this.hello.resume_token;
      body["resume_from"] = this.#seen();
    }
    const sent = new Moment();
    const reply = await new Promise<Reply>((resolve) => {
      const id = this.newId("hello");
      const request: Waiting["request"] = { type: "hello", id, body };
      this.#waiting.set(id, { request, made: sent, take: (told) => (resolve(told), true), lose: () => undefined, repeatable: true, cut: false, answered: false });
      link.send(request);
    });
    if (link !== this.#link) return;
    if (reply.error) return this.#refused(link, new RcpError(reply.error), resuming);
    this.#measure(sent, reply);
    clearTimeout(this.#opening);
    this.hello = reply.body as Hello;
    this.problem = undefined;
    const left = this.#addresses.begun() && !resuming ? this.#takeAlong() : [];
    if (!resuming) this.#loseAll("the session ended with the connection");
    this.#to("open");
    this.#pinging ??= setInterval(() => this.#ping(), (this.#options.ping ?? 2) * 1000);
    if (resuming) this.#resume();
    else this.#begin();
    if (left.length > 0) void this.#repeat(link, left);
  }

  /** Take out what may be sent again at another hub. */
  #takeAlong(): Waiting[] {
    const left = [...this.#waiting.values()].filter(({ request }) => MOVES.has(request.type) && repeatOf(request) !== "never");
    for (const { request } of left) this.#waiting.delete(request.id);
    return left;
  }

  /** Send again what another hub had not answered; robots' own gateways know the keys of what they were asked to do. */
  async #repeat(link: Link, left: Waiting[]): Promise<void> {
    const again = (one: Waiting): void => {
      if (link !== this.#link && this.state === "open") return one.lose(new ConnectionLost("the connection was lost again", undefined, one.repeatable));
      const { deadline = Infinity } = one.request;
      if (acts(one.request) && one.made.passed > deadline * 1000) return one.lose(unanswered(one.request, deadline));
      if (link !== this.#link) return void this.#waiting.set(one.request.id, { ...one, cut: true }); // the next session judges it
      one.cut = one.answered = false;
      this.#waiting.set(one.request.id, one);
      link.send(one.request);
    };
    for (const one of left) if (repeatOf(one.request) === "always") again(one);
    const keys = left.filter(({ request }) => repeatOf(request) === "keyed");
    if (keys.length === 0) return;
    const status = await this.ask({ type: "read", path: "/system/status", body: { fields: ["backends"] } }).catch(() => undefined);
    const backends = (status?.body as { backends?: { gateways?: boolean }[] } | undefined)?.backends ?? [];
    const known = backends.length > 0 && backends.every(({ gateways }) => gateways);
    for (const one of keys)
      if (known || link !== this.#link) again({ ...one, take: (reply) => this.#retake(one, reply, again) });
      else one.lose(new ConnectionLost("another gateway took over, which does not know what became of it", undefined, one.repeatable));
  }

  /** Take a reply to what was sent again: a refusal does not tell what became of it at the first hub. */
  #retake(one: Waiting, reply: Reply, again: (one: Waiting) => void): boolean {
    if (notYet(reply)) setTimeout(() => again({ ...one, take: (next) => this.#retake(one, next, again) }), AGAIN);
    else if (reply.status === "rejected") one.lose(new ConnectionLost(`another hub refused it: ${reply.error?.message}`, undefined, one.repeatable));
    else return one.take(reply);
    return true;
  }

  /** The session stands with what it had; mend what was asked while there was no connection. */
  #resume(): void {
    this.#settling = setTimeout(() => this.#giveUpCut(), SETTLE);
    for (const id of this.#orphans) void this.unsubscribe(id);
    for (const subscription of this.subscriptions.values())
      if (!subscription.made) this.subscribe(subscription).catch(() => undefined);
  }

  /** The session is a new one: nothing of an earlier one stands. */
  #begin(): void {
    this.#orphans.clear();
    for (const subscription of this.subscriptions.values()) {
      subscription.forget();
      this.subscribe(subscription).catch(() => undefined);
    }
    this.onfresh?.();
  }

  #refused(link: Link, error: RcpError, resuming: boolean): void {
    if (resuming) return void this.#greet(link, false); // the session is gone, or is not ours any more
    this.problem = error;
    if (!REFUSALS.has(error.code)) return link.close(error.message);
    this.#link = undefined;
    link.close(error.message);
    this.#stop("refused");
  }

  #stop(state: State): void {
    this.hello = undefined;
    clearTimeout(this.#opening);
    this.#loseAll(this.problem?.message ?? "refused");
    this.#to(state);
  }

  #lost(why: string): void {
    this.#link = undefined;
    clearTimeout(this.#opening);
    clearTimeout(this.#settling); // what this cut has left waits for the next resume
    clearInterval(this.#pinging);
    this.#pinging = this.#pinged = undefined;
    if (this.state === "closed" || this.state === "refused") return;
    const stood = this.state === "open";
    this.problem = new ConnectionLost(why);
    this.#loseHeld(why);
    for (const waiting of this.#waiting.values()) waiting.cut = true;
    for (const id of this.subscriptions.keys()) this.#lose(id, why); // asked for again, however late that is
    this.clock.reset();
    clearTimeout(this.#retry);
    this.#retry = setTimeout(() => this.#open(), this.#addresses.lost(stood) ? 0 : this.#backoff.next());
    this.#to("waiting");
  }

  /** Measure a round trip; after the `last` one commands are held no longer, however long it took. */
  #ping(last = false): void {
    const link = this.#link;
    if (link === undefined || this.state !== "open") return;
    if (this.#pinged && Math.min(this.#pinged.passed, this.#heard.passed) > SILENCE) return link.close("the gateway does not answer any more");
    const sent = new Moment();
    if (this.#pinged !== undefined) this.onchange?.();
    this.#pinged ??= sent;
    const id = this.newId("ping");
    const request: Waiting["request"] = { type: "ping", id };
    this.#waiting.set(id, {
      request,
      made: sent,
      take: (reply) => {
        this.#pinged = undefined;
        this.#measure(sent, reply);
        if (this.clock.known && (last || sent.passed <= PROMPT)) this.#sendHeld(link);
        else if (this.#held.length > 0) this.#ping(this.clock.known); // it slept meanwhile, or this was on the way for long
        this.#backoff.reset(); // it holds: one that is cut as soon as it stands is not tried ever faster
        this.onchange?.();
        return true;
      },
      lose: () => undefined,
      repeatable: true,
      cut: false,
      answered: false,
    });
    link.send(request);
  }

  /** Take a round trip. One that this machine slept in tells nothing: the answer may have lain here all the while. */
  #measure(sent: Moment, reply: Reply): void {
    if (reply.timestamp && !sent.torn) this.clock.measure(sent.steady, steady(), reply.timestamp);
  }

  // -- what comes in ------------------------------------------------------------------------

  #take(message: Incoming): void {
    this.#heard = new Moment();
    if (message.type === "update") {
      const update = message as Update;
      this.subscriptions.get(update.id)?.update(update);
    } else if (message.type === "notice") this.#notice(message as Notice);
    else this.#reply(message as Reply);
  }

  #reply(reply: Reply): void {
    const waiting = reply.id === undefined ? undefined : this.#waiting.get(reply.id);
    if (waiting !== undefined) {
      waiting.answered = true;
      if (waiting.take(reply)) this.#waiting.delete(reply.id as string);
    } else if (reply.type === "hello" && reply.error?.code === "token_expired") {
      this.problem = new RcpError(reply.error);
      this.#stop("refused");
    }
  }

  #notice(notice: Notice): void {
    const subscription = notice.id === undefined ? undefined : this.subscriptions.get(notice.id);
    subscription?.notice(notice);
    if (subscription && (notice.code === "overrun" || notice.code === "subscription_ended")) {
      this.subscriptions.delete(subscription.id);
      subscription.over(notice.error && new RcpError(notice.error));
    }
    this.onnotice?.(notice);
  }

  /** Ask for a subscription, for the first time or in a new session. */
  async subscribe(subscription: Subscription): Promise<Reply> {
    const body = { ...subscription.options, paths: subscription.paths };
    subscription.rest();
    try {
      const reply = await this.ask({ type: "subscribe", id: subscription.id, body });
      if (reply.error?.code === "duplicate_request") subscription.made = true; // it had arrived before the cut
      if (reply.error && !subscription.made) throw new RcpError(reply.error);
      subscription.stand();
      if (!reply.error) {
        subscription.reaches = (reply.body as { paths: string[] }).paths;
        if (reply.cursor !== undefined) this.#reachRest(subscription, reply.cursor).catch(() => undefined);
      }
      return reply;
    } catch (error) {
      // Without a connection it is asked for again with the next one.
      if (!(error instanceof ConnectionLost)) this.#later(subscription, error as RcpError);
      throw error;
    }
  }

  /** Ask again for what is refused for now, as while its robot comes up; what is refused for good has ended. */
  #later(subscription: Subscription, error: RcpError): void {
    const wanted = this.subscriptions.get(subscription.id) === subscription;
    // At first, too many are too many; after a cut, those of the session before may still count.
    const hopeful = error.retryable && (subscription.stood || error.code !== "queue_full");
    if (wanted && hopeful)
      subscription.after(error.retryAfter, () => {
        if (this.state === "open" && !subscription.made) this.subscribe(subscription).catch(() => undefined);
      });
    else {
      this.subscriptions.delete(subscription.id);
      subscription.over(error);
    }
  }

  /** List the paths that the reply to a subscription had no room for. */
  async #reachRest(subscription: Subscription, cursor: string): Promise<void> {
    const found = new Set(subscription.reaches);
    for (const path of subscription.paths) {
      let next: string | undefined = cursor;
      while (next !== undefined) {
        const body = { op: "subscribe", schemas: false, limit: 1000, cursor: next };
        const reply: Reply = await this.ask({ type: "discover", path, body });
        if (reply.error) return;
        for (const resource of (reply.body as Discovered).resources) found.add(resource.path);
        next = reply.cursor;
      }
    }
    subscription.reaches = [...found].sort();
  }

  /** End a subscription, now or as soon as there is a connection. */
  async unsubscribe(id: string): Promise<void> {
    this.#orphans.add(id);
    try {
      await this.ask({ type: "unsubscribe", body: { subscription: id } });
      this.#orphans.delete(id);
    } catch {
      // It stays with the orphans.
    }
  }

  #seen(): Record<string, number> {
    const seen: Record<string, number> = {};
    for (const subscription of this.subscriptions.values())
      for (const [path, seq] of subscription.seen) seen[path] = Math.min(seq, seen[path] ?? seq);
    return seen;
  }

  /** Give up what never had an answer; a command that was accepted is told of however long it runs. */
  #giveUpCut(): void {
    for (const [id, waiting] of this.#waiting)
      if (waiting.cut && !waiting.answered) this.#lose(id, "the connection was cut before the answer came");
  }

  #lose(id: string, why: string): void {
    const waiting = this.#waiting.get(id);
    this.#waiting.delete(id);
    waiting?.lose(new ConnectionLost(why, undefined, waiting.repeatable));
  }

  #loseHeld(why: string): void {
    for (const { asked, timer } of this.#held.splice(0)) {
      clearTimeout(timer);
      asked.lose(new ConnectionLost(why));
    }
  }

  #loseAll(why: string): void {
    this.#loseHeld(why);
    const waiting = [...this.#waiting.values()];
    this.#waiting.clear();
    for (const one of waiting) one.lose(new ConnectionLost(why, undefined, one.repeatable));
  }

  #to(state: State): void {
    this.state = state;
    this.onchange?.();
  }
}
