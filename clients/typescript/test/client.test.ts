// Run by tests/clients/test_typescript.py against a demo gateway: RCP_URL, RCP_TOKEN and RCP_ADMIN say where and who,
// RCP_ENCODING in which encoding.
import assert from "node:assert/strict";
import { afterEach, test } from "node:test";

import { Clock, Moment } from "../src/clock.ts";
import { Client, ConnectionLost, Lease, RcpError, type Step, type Update } from "../src/index.ts";
import { msgpack } from "../src/msgpack.ts";

const url = process.env["RCP_URL"] as string;
const token = process.env["RCP_TOKEN"] as string;
const admin = process.env["RCP_ADMIN"] as string;
const binary = process.env["RCP_ENCODING"] === "msgpack";
const codec = binary ? { codec: msgpack } : {};
const open: Client[] = [];

async function connected(how: { token?: string; tenant?: string } = { token, tenant: "alpha" }): Promise<Client> {
  const client = new Client({ url, ping: 0.05, ...codec, ...how });
  open.push(client);
  await client.connect();
  return client;
}

afterEach(() => open.splice(0).forEach((client) => client.close()));

/** Wait until something is so, told of changes by nobody. */
async function until(so: () => boolean, what: string): Promise<void> {
  const end = Date.now() + 15_000;
  while (!so()) {
    assert.ok(Date.now() < end, `not in time: ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 10));
  }
}

async function refusal(doing: Promise<unknown>): Promise<RcpError> {
  const error = await doing.then(() => undefined, (told: unknown) => told);
  assert.ok(error instanceof RcpError, `not refused: ${error}`);
  return error;
}

test("the gateway's time stays known while this machine's clock is set", () => {
  const clock = new Clock();
  const sent = performance.timeOrigin + performance.now();
  const told = new Date(sent + 5_001).toISOString(); // its clock is 5 s ahead
  clock.measure(sent, sent + 2, told);
  const wall = Date.now;
  try {
    Date.now = () => wall() - 3_600_000;
    const now = performance.timeOrigin + performance.now();
    assert.ok(Math.abs(clock.now() - now - 5_000) < 500, "commands are of now, and not of an hour ago");
  } finally {
    Date.now = wall;
  }
});

test("what was measured before this machine slept is forgotten", () => {
  const clock = new Clock();
  const sent = performance.timeOrigin + performance.now();
  clock.measure(sent, sent + 2, new Date(sent + 1).toISOString());
  const wall = Date.now;
  try {
    Date.now = () => wall() + 60_000; // the other clock stood
    clock.measure(sent, sent + 10, new Date(sent + 60_005).toISOString());
    assert.equal(Math.round((clock.now() - performance.timeOrigin - performance.now()) / 1000), 60);
  } finally {
    Date.now = wall;
  }
});

test("after a sleep nothing is young, and no command is of before it", () => {
  const clock = new Clock();
  const sent = performance.timeOrigin + performance.now();
  clock.measure(sent, sent + 2, new Date(sent + 1).toISOString());
  const sample = new Date(clock.now()).toISOString();
  const before = new Moment();
  const wall = Date.now;
  try {
    assert.ok(clock.known && !before.torn);
    Date.now = () => wall() + 28_800_000; // the other clock stood for eight hours
    assert.ok(!clock.known, "there was no round trip since");
    assert.ok(before.torn, "an answer to what was sent before tells nothing");
    assert.ok(Math.abs(clock.age(sample) - 28_800) < 1, `it is of before the sleep: ${clock.age(sample)}`);
    clock.measure(sent, sent + 2, "nothing that is a time");
    assert.ok(!clock.known);
    const now = performance.timeOrigin + performance.now();
    clock.measure(now - 2, now, new Date(wall() + 28_800_000).toISOString());
    assert.ok(clock.known && Math.abs(clock.age(sample) - 28_800) < 1);
  } finally {
    Date.now = wall;
  }
});

test("the first command after a sleep waits for a round trip, and is not stale", async () => {
  const client = new Client({ url, token, tenant: "alpha", ping: 3600, ...codec });
  open.push(client);
  await client.connect();
  const stood = performance.now;
  try {
    assert.ok(client.clock.known, "hello was a round trip");
    performance.now = () => stood.call(performance) - 60_000;
    assert.ok(!client.clock.known);
    await client.write("/actuator/cmd_vel", { linear: { x: 0 }, angular: { z: 0 } });
    assert.ok(client.clock.known, "by a ping that did not wait for its turn");
  } finally {
    performance.now = stood;
  }
});

test("hello says who and where, and pings measure the way and the clock", async () => {
  const client = await connected();
  assert.equal(client.hello?.principal, "demo-operator");
  assert.equal(client.hello?.tenant, "alpha");
  await until(() => client.clock.latency !== undefined, "a round trip");
  assert.ok(Math.abs(client.clock.offset) < 1, "one machine has one clock");
});

test("what is asked as soon as the connection is open is answered", async () => {
  const client = new Client({ url, token, tenant: "alpha" });
  open.push(client);
  const answer = new Promise((resolve, reject) => {
    client.onChange(() => client.state === "open" && client.read("/sensor/pose").then(resolve, reject));
  });
  await client.connect();
  assert.ok(await answer);
});

test("without a token one is anonymous, with a wrong one refused", async () => {
  const client = await connected({});
  assert.equal(client.hello?.principal, "anonymous");
  const wrong = new Client({ url, token: "rcp_op_wrong" });
  assert.equal((await refusal(wrong.connect())).code, "unauthenticated");
  assert.equal(wrong.state, "refused");
});

test("read, write, and refusals with their code, details and remedy", async () => {
  const client = await connected();
  const { value, state, seq } = await client.read("/sensor/pose");
  assert.equal(typeof value.position.x, "number");
  assert.equal(state, "fresh");
  assert.ok(seq !== undefined);
  assert.equal(await client.write("/param/speed_limit", 0.7), 0.7);
  assert.equal((await client.read("/param/speed_limit")).value, 0.7);
  await client.write("/param/speed_limit", 1);
  const both = { "/actuator/cmd_vel": { linear: { x: 0 } }, "/param/speed_limit": 0.8 };
  assert.equal((await client.writeAll(both))["/param/speed_limit"], 0.8);
  await client.write("/param/speed_limit", 1);
  const wrong = await refusal(client.writeAll({ ...both, "/param/speed_limit": 9 }));
  assert.equal((wrong.details as any).faults[0].code, "out_of_range");
  const error = await refusal(client.write("/param/speed_limit", 9));
  assert.equal(error.code, "out_of_range");
  assert.equal(error.details["unit"], "m/s");
  assert.ok(error.remedy);
  assert.equal((await refusal(client.read("/sensor/nothing"))).code, "unknown_path");
});

test("a dry run changes nothing", async () => {
  const client = await connected();
  const before = (await client.read("/param/speed_limit")).value;
  await client.write("/param/speed_limit", 0.3, { dryRun: true });
  assert.equal((await client.read("/param/speed_limit")).value, before);
});

test("a command is accepted, feeds back and ends", async () => {
  const client = await connected();
  const command = client.execute("/action/move_to", { position: { x: 0.4, y: 0, z: 0 } });
  assert.ok(await command.accepted);
  let fed = 0;
  for await (const { body } of command) fed += body === undefined ? 0 : 1;
  assert.ok(fed > 0);
  assert.ok((await command.result).pose);
  assert.equal(command.status, "completed");
});

test("a command is cancelled", async () => {
  const client = await connected();
  const command = client.execute("/action/move_to", { position: { x: 5, y: 0 }, speed: 0.1 });
  await command.accepted;
  await command.cancel();
  assert.equal((await refusal(command.result)).code, "cancelled");
  assert.equal(command.status, "cancelled");
});

test("a refused command rejects both of its promises", async () => {
  const client = await connected();
  const command = client.execute("/action/move_to", { position: "here" });
  assert.equal((await refusal(command.accepted)).code, "invalid_value");
  assert.equal((await refusal(command.result)).code, "invalid_value");
});

test("discover pages through what the asker may see", async () => {
  const client = await connected();
  const all = await client.discoverAll("/tenant/**", { limit: 5 });
  assert.ok(all.length > 30);
  assert.equal(new Set(all.map((one) => one.path)).size, all.length);
  const looker = await connected({});
  const seen = await looker.discoverAll("/tenant/alpha/actuator/*");
  assert.deepEqual(seen[0]?.operations.includes("write"), false);
});

test("a subscription goes on after a cut, without loss and without repetition", async () => {
  const client = await connected();
  const got: Update[] = [];
  let gaps = 0;
  const qos = { reliability: "reliable" } as const;
  const subscription = client.subscribe("/sensor/pose", { qos }, {
    update: (update) => got.push(update),
    notice: (notice) => (gaps += notice.code === "gap" ? 1 : 0),
  });
  await until(() => got.length > 10, "samples");
  const session = client.hello?.session;
  client.session.cut();
  const error = await refusal(client.read("/sensor/pose"));
  assert.ok(error instanceof ConnectionLost);
  const had = got.length;
  await until(() => got.length > had + 30, "samples after the cut");
  assert.equal(client.hello?.session, session);
  assert.equal(gaps, 0);
  got.forEach((update, at) => assert.equal(update.seq, (got[0] as Update).seq + at));
  await subscription.close();
});

test("what was asked for while there was no connection is asked for when there is one", async () => {
  const client = await connected();
  const pose = client.subscribe("/sensor/pose", {}, { update: () => undefined });
  await until(() => pose.made, "a subscription");
  client.session.cut();
  let battery = 0;
  client.subscribe("/sensor/battery", {}, { update: () => (battery += 1) });
  await pose.close();
  await until(() => battery > 0, "the one asked for in between");
});

test("what was being asked for when the connection was cut stands when it is back, however late", async (t) => {
  const client = await connected();
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let battery = 0;
  client.subscribe("/sensor/battery", {}, { update: () => (battery += 1) });
  client.session.cut();
  t.mock.timers.tick(60_000);
  t.mock.timers.reset();
  client.session.hurry();
  await until(() => battery > 0, "the one that was under way");
});

test("a command runs on through a cut and its end is told", async () => {
  const client = await connected();
  const command = client.execute("/action/move_to", { position: { x: 0, y: 0 } });
  await command.accepted;
  client.session.cut();
  assert.ok((await command.result).pose);
});

/** Cut the connection, and wait until the session is back, without a timer of anybody. */
async function cutAndReturn(client: Client): Promise<void> {
  const back = new Promise<void>((resolve) => {
    const stop = client.onChange(() => client.state === "open" && (stop(), resolve()));
  });
  client.session.cut();
  client.session.hurry();
  await back;
}

test("a command that was accepted is told of however long it runs after a cut", async (t) => {
  const client = await connected();
  const command = client.execute("/action/move_to", { position: { x: 5, y: 0 }, speed: 0.1 });
  await command.accepted;
  t.mock.timers.enable({ apis: ["setTimeout"] });
  await cutAndReturn(client);
  t.mock.timers.tick(60_000);
  t.mock.timers.reset();
  await command.cancel();
  assert.equal((await refusal(command.result)).code, "cancelled");
});

test("what may have acted may be repeated only with a key, whether its connection is lost or its answer is late", async (t) => {
  const zero = { linear: { x: 0 }, angular: { z: 0 } };
  const asked = (client: Client): Promise<unknown>[] => [
    client.read("/sensor/pose"),
    client.write("/actuator/cmd_vel", zero),
    client.write("/actuator/cmd_vel", zero, { idempotencyKey: `w-${Math.random()}` }),
    client.write("/actuator/cmd_vel", zero, { dryRun: true }),
    client.execute("/action/move_to", { position: { x: 0, y: 0 } }).result,
    client.execute("/action/move_to", { position: { x: 0, y: 0 } }, { idempotencyKey: `x-${Math.random()}` }).result,
    client.hold(),
    client.estop({ scope: "/tenant/nobody" }),
    client.resetEstop({ scope: "/tenant/nobody" }),
  ];
  const safe = [true, false, true, true, false, true, true, true, false];
  const lost = await connected();
  const pending = asked(lost);
  lost.close(); // sent, and no answer was taken
  assert.deepEqual((await Promise.all(pending.map(refusal))).map((error) => error.retryable), safe);
  const unsent = await Promise.all(asked(lost).map(refusal));
  assert.ok(unsent.every((error) => error instanceof ConnectionLost && error.retryable), "nothing was sent");
  const late = await connected();
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const all = asked(late);
  const waiting = all.slice(0, 4);
  for (const one of all) one.catch(() => undefined); // a command is not limited, and ends with its client
  t.mock.timers.tick(12_000);
  t.mock.timers.reset();
  const errors = await Promise.all(waiting.map(refusal));
  assert.ok(errors.every((error) => error.code === "deadline_exceeded"));
  assert.deepEqual(errors.map((error) => error.retryable), safe.slice(0, 4));
});

test("what a second cut leaves without an answer is given the whole time after it", async (t) => {
  const client = await connected();
  t.mock.timers.enable({ apis: ["setTimeout"] });
  await cutAndReturn(client);
  t.mock.timers.tick(2999);
  let lost = false;
  client.read("/sensor/pose").catch(() => (lost = true)); // its answer goes to the connection that is cut
  await cutAndReturn(client);
  t.mock.timers.tick(1);
  await new Promise((resolve) => setImmediate(resolve));
  assert.equal(lost, false);
});

test("watching yields until the loop is left, and a refusal ends it", async () => {
  const client = await connected();
  let count = 0;
  for await (const update of client.watch("/sensor/pose")) if (update.seq && ++count === 3) break;
  assert.equal(client.session.subscriptions.size, 0);
  const wrong = client.watch("/sensor/nothing").next();
  assert.equal((await refusal(wrong)).code, "unknown_path");
});

test("a lease keeps others out until it is released, and a loss is told", async () => {
  const [mine, other] = [await connected(), await connected({ token: admin, tenant: "alpha" })];
  let lost = "";
  const lease = await mine.lease("/tenant/alpha/actuator", { lost: (notice) => (lost = String(notice?.reason)) });
  const drive = { linear: { x: 0 }, angular: { z: 0 } };
  assert.equal((await refusal(other.write("/actuator/cmd_vel", drive))).code, "lease_held");
  await mine.write("/actuator/cmd_vel", drive);
  await lease.release();
  await other.write("/actuator/cmd_vel", drive);
  await mine.lease("/tenant/alpha/actuator", { lost: (notice) => (lost = notice?.code ?? "") });
  await other.estop({ scope: "/tenant/alpha", reason: "tried" });
  await until(() => lost === "lease_lost", "the notice of the loss");
  await other.resetEstop({ scope: "/tenant/alpha" });
});

test("a lease that its own session gave away is lost at the next renewal", async () => {
  const client = await connected();
  let lost = 0;
  const lease = await client.lease("/tenant/alpha/actuator", { ttl: 1, lost: () => (lost += 1) });
  await client.execute("/system/leases", { do: "release", lease: lease.state.lease }).result;
  await until(() => lost === 1, "the loss");
});

test("a lease is handed over, and the heir goes on with it", async () => {
  const [mine, heir] = [await connected(), await connected({ token: admin, tenant: "alpha" })];
  const [scope, drive] = ["/tenant/alpha/actuator", { linear: { x: 0 }, angular: { z: 0 } }];
  let lost = 0;
  const lease = await mine.lease(scope, { lost: () => (lost += 1) });
  assert.equal((await refusal(lease.handOver("nobody"))).code, "unknown_path");
  assert.ok(lease.held);
  await mine.write("/actuator/cmd_vel", drive);
  const given = await lease.handOver(heir.hello?.session.slice(0, 8) as string);
  assert.equal(given.holder, "demo-admin");
  assert.equal(lease.held, false);
  assert.equal((await refusal(mine.write("/actuator/cmd_vel", drive))).code, "lease_held");
  await heir.write("/actuator/cmd_vel", drive);
  await lease.release(); // nothing of his is released
  assert.equal((await refusal(mine.write("/actuator/cmd_vel", drive))).code, "lease_held");
  await (await heir.lease(scope)).release();
  await mine.write("/actuator/cmd_vel", drive);
  assert.equal(lost, 0);
});

test("a release that failed is asked for again, and one that had arrived is none too few", async () => {
  const [mine, other] = [await connected(), await connected({ token: admin, tenant: "alpha" })];
  const [scope, drive] = ["/tenant/alpha/actuator", { linear: { x: 0 }, angular: { z: 0 } }];
  for (const arrived of [false, true]) {
    const lease = await mine.lease(scope, { ttl: 60 });
    const id = lease.state.lease;
    const failed = new Promise<RcpError>((resolve) => {
      const stop = mine.onChange(() => mine.state === "waiting" && (stop(), resolve(refusal(lease.release()))));
    });
    mine.session.cut();
    assert.equal((await failed).code, "connection_lost");
    assert.equal(lease.held, false);
    mine.session.hurry();
    await until(() => mine.state === "open", "the connection");
    assert.equal((await refusal(other.write("/actuator/cmd_vel", drive))).code, "lease_held");
    if (arrived) await mine.execute("/system/leases", { do: "release", lease: id }).result;
    await lease.release();
    await other.write("/actuator/cmd_vel", drive);
    await lease.release(); // nothing is owed any more
  }
});

const soon = (): Promise<unknown> => new Promise((resolve) => setImmediate(() => resolve(undefined)));

test("a lease is renewed while it is handed over and after it was refused, once in a third of its time", async (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const state = { lease: "lease-1" } as Lease["state"];
  const gone = new RcpError({ code: "lease_required", message: "no lease" });
  const asked: { what: unknown; grant: (state: Lease["state"]) => void; refuse: (error: RcpError) => void }[] = [];
  const ask = ({ do: what }: Record<string, unknown>): Promise<Lease["state"]> =>
    new Promise((grant, refuse) => asked.push({ what, grant, refuse }));
  let lost = 0;
  const lease = new Lease(state, 3, ask, { ended: () => undefined, lost: () => (lost += 1) });
  const count = (what: string): number => asked.filter((one) => one.what === what).length;
  t.mock.timers.tick(1000); // a renewal is under way
  const first = lease.handOver("nobody");
  asked[0]?.grant(state);
  await soon();
  t.mock.timers.tick(1000);
  assert.equal(count("renew"), 2);
  asked[1]?.refuse(new RcpError({ code: "unknown_path", message: "nobody" }));
  assert.equal((await refusal(first)).code, "unknown_path");
  asked[2]?.grant(state);
  await soon();
  for (const passed of [3, 4, 5]) {
    t.mock.timers.tick(1000);
    assert.equal(count("renew"), passed);
    asked.at(-1)?.grant(state);
    await soon();
  }
  const second = lease.handOver("heir");
  t.mock.timers.tick(1000);
  asked.at(-1)?.refuse(gone); // it is the heir's already
  await soon();
  assert.ok(lease.held);
  asked.at(-2)?.grant({ ...state, holder: "heir" });
  assert.equal((await second).holder, "heir");
  t.mock.timers.tick(60_000);
  assert.equal(count("renew"), 6);
  assert.equal(lost, 0);
  assert.equal(lease.held, false);
});

const move = (x: number, how: { speed?: number } = {}): Step => ({
  do: "execute", path: "/action/move_to", value: { position: { x, y: 0 }, ...how },
});

test("a plan is checked without effect, and its result has each step", async () => {
  const client = await connected();
  const steps: Step[] = [
    { do: "read", path: "/sensor/pose", id: "start" },
    { do: "write", path: "/param/speed_limit", value: 1 },
    { do: "execute", path: "/action/move_to", value: { position: { $result: "start/position" } }, id: "there" },
  ];
  const planned = await client.validatePlan(steps);
  assert.deepEqual(planned.map((one) => one.step), ["start", "2", "there"]);
  assert.equal(planned[2]?.path, "/tenant/alpha/action/move_to");
  const plan = client.plan({ name: "stay", steps });
  const states = await plan.result;
  assert.deepEqual(states.map(({ step, state }) => [step, state]), [...plan.steps.values()].map(({ step, state }) => [step, state]));
  assert.ok(states.every(({ state }) => state === "completed"));
  assert.equal(typeof states[0]?.result.position.x, "number");
  assert.equal((await client.read("/system/plans")).value[0].name, "stay");
});

test("a plan that is wrong is refused with all of its faults", async () => {
  const client = await connected();
  const error = await refusal(client.validatePlan("execute /action/mov_to x=1\nwrite /param/speed_limit 99"));
  assert.deepEqual(error.details["faults"].map((fault: { code: string }) => fault.code), ["unknown_path", "out_of_range"]);
  assert.equal((await refusal(client.plan([move(1), { do: "read", path: "/sensor/nothing" }]).result)).code, "unknown_path");
  const broken = client.plan('[{"do": "read"');
  assert.equal((await refusal(broken.result)).code, "bad_request");
  assert.equal((await refusal(broken.cancel())).code, "bad_request");
  const [symbolic] = await client.validatePlan("; found in 0.01 s\n(move_to alpha 0.1 0.0)");
  assert.deepEqual(symbolic?.value.position, { x: 0.1, y: 0 });
  const [json] = await client.validatePlan(JSON.stringify({ steps: [move(0.1)] }));
  assert.equal(json?.path, symbolic?.path);
});

test("a cancelled plan has stopped the robot, and says how far it came", async () => {
  const client = await connected();
  const plan = client.plan([move(5, { speed: 0.1 }), move(0)]);
  for await (const { body } of plan) if (body.feedback !== undefined) await plan.cancel();
  const error = await refusal(plan.result);
  assert.equal(error.code, "cancelled");
  assert.deepEqual([...plan.steps.values()].map(({ state }) => state), ["cancelled", "skipped"]);
  assert.deepEqual(error.details["body"].steps.length, 2);
});

test("a pattern is read whole, and page by page", async () => {
  const client = await connected();
  const { value } = await client.read("/tenant/*/sensor/**");
  const paths = value.map((item: { path: string }) => item.path);
  assert.ok(paths.length > 3);
  const pages: string[][] = [];
  for await (const items of client.pages("/tenant/*/sensor/**", { limit: 3 })) pages.push(items.map((item) => item.path));
  assert.ok(pages.every((page) => page.length <= 3));
  assert.ok(pages.length >= paths.length / 3); // a picture may end a page before its limit
  assert.deepEqual(pages.flat(), paths);
});

test("a hold brings a robot to rest and latches nothing", async () => {
  const client = await connected();
  assert.equal((await client.hold("/tenant/alpha")).at_rest, true);
  assert.equal((await client.hold()).at_rest, true);
  assert.equal((await client.read("/system/estop")).value.active, false);
  assert.equal((await refusal(client.hold("nobody"))).code, "unknown_path");
});

test("an e-stop holds until it is reset by who may", async () => {
  const [operator, boss] = [await connected(), await connected({ token: admin, tenant: "alpha" })];
  const stopped = await operator.estop({ scope: "/tenant/alpha" });
  assert.equal(stopped.active, true);
  const states = Object.values(stopped.robots);
  assert.ok(states.length > 0 && states.every((robot) => robot.state === "confirmed" && robot.confirmed));
  const drive = { linear: { x: 0.1 }, angular: { z: 0 } };
  assert.equal((await refusal(operator.write("/actuator/cmd_vel", drive))).code, "estop_active");
  assert.equal((await refusal(operator.resetEstop({ dryRun: true }))).code, "forbidden");
  const { reset } = await boss.resetEstop({ scope: "/tenant/alpha" });
  assert.ok(reset && Date.parse(reset) > 0);
  // The clock of the gateway is known to half a round trip: one more, and the command is the younger for sure.
  await new Promise((resolve) => setTimeout(resolve, 50));
  await operator.write("/actuator/cmd_vel", { linear: { x: 0 }, angular: { z: 0 } });
});

test("bytes are bytes in MessagePack, and base64 in JSON", async () => {
  const client = await connected();
  const { value } = await client.read("/sensor/camera");
  const bytes = binary ? value.data : Uint8Array.from(atob(value.data), (letter) => letter.charCodeAt(0));
  assert.ok(bytes instanceof Uint8Array);
  assert.deepEqual([...bytes.subarray(0, 4)], [0x89, 0x50, 0x4e, 0x47]);
});

test("one subscription may be MessagePack on a connection that is not", async () => {
  const client = new Client({ url, token, tenant: "alpha", codec: msgpack, encoding: "json" });
  open.push(client);
  await client.connect();
  const { value } = await client.read("/sensor/camera");
  assert.equal(typeof value.data, "string");
  for await (const { body, path } of client.watch("/sensor/camera", { encoding: "msgpack" })) {
    assert.equal(path, "/tenant/alpha/sensor/camera");
    assert.ok(body.data instanceof Uint8Array);
    client.session.cut();
    break;
  }
  for await (const { body } of client.watch("/sensor/scan", { encoding: "msgpack" })) {
    assert.ok(body.ranges.includes(Infinity)); // a string in JSON
    break;
  }
});

test("integers of MessagePack are numbers where JavaScript has them, else their digits", () => {
  const wide = (head: number, value: bigint): unknown => {
    const view = new DataView(new ArrayBuffer(9));
    view.setUint8(0, head);
    view.setBigInt64(1, value);
    return msgpack.decode(new Uint8Array(view.buffer));
  };
  assert.equal(wide(0xcf, 2n ** 53n - 1n), Number.MAX_SAFE_INTEGER);
  assert.equal(wide(0xcf, 2n ** 63n), "9223372036854775808");
  assert.equal(wide(0xd3, -(2n ** 63n)), "-9223372036854775808");
  assert.equal(wide(0xd3, -5_000_000_000n), -5_000_000_000);
  assert.deepEqual(msgpack.decode(msgpack.encode({ a: 2 ** 40, b: undefined, c: [1.5, null] })), { a: 2 ** 40, c: [1.5, null] });
});
