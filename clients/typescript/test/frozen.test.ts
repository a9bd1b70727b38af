// Run by tests/clients/test_typescript.py against a demo gateway: a connection that is half dead while this machine sleeps.
import assert from "node:assert/strict";
import { connect, createServer, type Socket } from "node:net";
import { afterEach, beforeEach, test } from "node:test";

import { Client, RcpError } from "../src/index.ts";
import type { Request } from "../src/wire.ts";

const gateway = new URL(process.env["RCP_URL"] as string);
const token = process.env["RCP_TOKEN"] as string;
const STILL = { linear: { x: 0 }, angular: { z: 0 } };
const DRIVE = "/actuator/cmd_vel";

/** Passes all on to the gateway, but nothing while it is frozen: then it lies there. */
class Way {
  readonly #server = createServer((client) => this.#join(client));
  #ends = new Set<Socket>();
  frozen = false;

  async open(): Promise<string> {
    await new Promise<void>((resolve) => this.#server.listen(0, "127.0.0.1", resolve));
    const { port } = this.#server.address() as { port: number };
    return `http://127.0.0.1:${port}`;
  }

  #join(client: Socket): void {
    const there = connect(Number(gateway.port), gateway.hostname);
    for (const [one, other] of [[client, there], [there, client]] as const) {
      this.#ends.add(one);
      one.on("data", (data) => void other.write(data));
      one.on("close", () => other.destroy());
      one.on("error", () => other.destroy());
      if (this.frozen) one.pause();
    }
  }

  freeze(): void {
    this.frozen = true;
    for (const end of this.#ends) end.pause();
  }

  thaw(): void {
    this.frozen = false;
    for (const end of this.#ends) end.resume();
  }

  cut(): void {
    for (const end of this.#ends) end.destroy();
    this.#ends.clear();
  }

  close(): void {
    this.cut();
    this.#server.close();
  }
}

const Bare = globalThis.WebSocket;
const stood = performance.now;
let sent: Request[];
let way: Way;
let client: Client;

class Heard extends Bare {
  override send(data: string | ArrayBufferLike | Blob | ArrayBufferView): void {
    sent.push(JSON.parse(data as string) as Request);
    super.send(data);
  }
}

beforeEach(async () => {
  sent = [];
  way = new Way();
  globalThis.WebSocket = Heard;
  client = new Client({ url: await way.open(), token, tenant: "alpha", ping: 3600 });
  await client.connect();
});

afterEach(() => {
  performance.now = stood;
  globalThis.WebSocket = Bare;
  client.close();
  way.close();
});

/** Let the steady clock stand for a minute, as it does in a sleep. */
function sleep(): void {
  performance.now = () => stood.call(performance) - 60_000;
}

const commands = (): Request[] => sent.filter(({ type }) => type === "write" || type === "execute");

async function refusal(doing: Promise<unknown>): Promise<RcpError> {
  const error = await doing.then(() => undefined, (told: unknown) => told);
  assert.ok(error instanceof RcpError, `not refused: ${error}`);
  return error;
}

async function answered(): Promise<void> {
  const end = Date.now() + 15_000;
  while (!client.clock.known) {
    assert.ok(Date.now() < end, "no round trip");
    await new Promise((resolve) => setTimeout(resolve, 10));
  }
}

test("a command that its deadline has overtaken is never sent, however late the connection comes to life", async () => {
  way.freeze();
  sleep();
  const writing = client.write(DRIVE, STILL, { deadline: 0.2 });
  const running = client.execute("/action/dock", {}, { deadline: 0.2 });
  for (const error of [await refusal(writing), await refusal(running.result)]) {
    assert.equal(error.code, "deadline_exceeded");
    assert.ok(error.retryable, "nothing was sent");
  }
  assert.ok(running.done);
  way.thaw();
  await answered();
  await client.read("/sensor/pose");
  assert.deepEqual(commands(), []);
});

test("a command that is young enough is sent once the connection lives, as of when it was made", async () => {
  way.freeze();
  sleep();
  const made = Date.now();
  const writing = client.write(DRIVE, STILL, { deadline: 30 });
  const another = client.execute("/action/dock", {});
  assert.deepEqual(commands(), []);
  await new Promise((resolve) => setTimeout(resolve, 1000));
  way.thaw();
  await writing.catch(() => undefined); // it may be older than its path allows
  await another.accepted.catch(() => undefined);
  const [first, second] = commands();
  assert.equal(first?.path, DRIVE, "in their order");
  assert.ok(Math.abs(Date.parse(first?.timestamp as string) - made) < 250, "neither as of when it was sent, nor half way");
  assert.ok((first?.deadline as number) < 29.1, "what is left of it");
  assert.ok(second?.timestamp);
  await another.cancel().catch(() => undefined);
});

test("what a stop or a cancel overtakes is not sent after it", async () => {
  way.freeze();
  sleep();
  const [moving, other] = [client.execute("/action/dock", {}), client.execute("/action/move_to", { position: { x: 1, y: 0 } })];
  const cancelled = moving.cancel();
  assert.equal((await refusal(moving.result)).code, "cancelled");
  const held = client.hold();
  assert.equal((await refusal(other.result)).code, "cancelled");
  way.thaw();
  await held;
  await cancelled;
  await answered();
  assert.deepEqual(commands().map(({ path }) => path), ["/service/hold"]);
});

test("a plan that is cancelled before it was sent is not sent", async () => {
  way.freeze();
  sleep();
  const plan = client.plan([{ do: "execute", path: "/action/dock" }]);
  await plan.cancel();
  assert.equal((await refusal(plan.result)).code, "cancelled");
  way.thaw();
  await answered();
  assert.deepEqual(sent.filter(({ type }) => type === "execute" || type === "cancel"), []);
});

test("a cancel overtakes what it is of, and nothing else that waits", async () => {
  const running = client.execute("/action/dock", {});
  const id = await running.accepted;
  way.freeze();
  sleep();
  const both = client.writeAll({ [DRIVE]: STILL }).catch(() => undefined);
  const next = client.execute("/action/dock", {});
  const cancelled = client.cancel(id);
  const wide = client.execute("/action/move_to", { position: { x: 1, y: 0 } });
  const cancelling = client.cancel({ path: "/tenant/alpha/action/move_to" }).catch(() => undefined);
  assert.equal((await refusal(wide.result)).code, "cancelled");
  way.thaw();
  await Promise.all([cancelled, both, cancelling]);
  await next.accepted.catch(() => undefined);
  assert.deepEqual(commands().map(({ path }) => path), ["/action/dock", undefined, "/action/dock"]);
  await next.cancel().catch(() => undefined);
});

test("what waits when the connection is cut fails at once, and is not sent over the next one", async () => {
  way.freeze();
  sleep();
  const writing = refusal(client.write(DRIVE, STILL));
  way.cut();
  const error = await writing;
  assert.equal(error.code, "connection_lost");
  assert.ok(error.retryable, "nothing was sent");
  way.thaw();
  client.session.hurry();
  await answered();
  await client.read("/sensor/pose");
  assert.deepEqual(commands(), []);
});
