// Drives a gateway by Foxglove's own client and decoders; prints what it found as one JSON object.
import { createRequire } from "node:module";
import { text } from "node:stream/consumers";

const require = createRequire(import.meta.url);
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");

const PATIENCE = 60_000; // ms that any step may take
const given = JSON.parse(await text(process.stdin));

async function within(what, promise) {
  let timer;
  const late = new Promise((_, reject) => {
    timer = setTimeout(() => reject(new Error(`${what} took too long`)), PATIENCE);
  });
  try {
    return await Promise.race([promise, late]);
  } finally {
    clearTimeout(timer);
  }
}

class Session {
  channels = new Map();
  services = new Map();
  statuses = [];
  messages = new Map();
  waiting = new Set();
  events = {};

  constructor(url, subprotocol) {
    this.socket = new WebSocket(url, [subprotocol]);
    this.client = new FoxgloveClient({ ws: this.socket });
    for (const name of [
      "open", "close", "error", "serverInfo", "status", "parameterValues", "serviceCallResponse",
      "serviceCallFailure", "connectionGraphUpdate", "fetchAssetResponse",
    ]) {
      this.events[name] = [];
      this.client.on(name, (event) => this.news(() => this.events[name].push(event ?? {})));
    }
    this.client.on("advertise", (channels) =>
      this.news(() => channels.forEach((one) => this.channels.set(one.topic, one))));
    this.client.on("advertiseServices", (services) =>
      this.news(() => services.forEach((one) => this.services.set(one.name, one))));
    this.client.on("message", ({ subscriptionId, data, timestamp }) =>
      this.news(() => this.messages.get(subscriptionId)?.push({ data, timestamp })));
  }

  news(change) {
    change();
    for (const look of this.waiting) look();
  }

  until(what, found) {
    return within(what, new Promise((resolve) => {
      const look = () => {
        const value = found();
        if (value !== undefined && value !== false) {
          this.waiting.delete(look);
          resolve(value);
        }
      };
      this.waiting.add(look);
      look();
    }));
  }

  event(name, fits = () => true) {
    return this.until(name, () => {
      const at = this.events[name].findIndex(fits);
      return at < 0 ? undefined : this.events[name].splice(at, 1)[0];
    });
  }

  // Which of several events comes first.
  first(...names) {
    return this.until(names.join(" or "), () => names.find((name) => this.events[name].length));
  }

  channel(topic) {
    return this.until(`channel ${topic}`, () => this.channels.get(topic));
  }

  async subscribe(topic) {
    const channel = await this.channel(topic);
    const id = this.client.subscribe(channel.id);
    this.messages.set(id, []);
    return { channel, id };
  }

  async next({ id, channel }) {
    const { data } = await this.until(`message on ${channel.topic}`, () => this.messages.get(id).shift());
    return decoded(channel, data);
  }

  async call(name, request, callId) {
    const service = await this.until(`service ${name}`, () => this.services.get(name));
    const cdr = service.request.encoding === "cdr";
    const data = cdr
      ? new MessageWriter(parse(service.request.schema, { ros2: true })).writeMessage(request)
      : new TextEncoder().encode(JSON.stringify(request));
    this.client.sendServiceCallRequest({
      serviceId: service.id, callId, encoding: service.request.encoding, data,
    });
    const response = await this.event("serviceCallResponse", (one) => one.callId === callId);
    return cdr
      ? new MessageReader(parse(service.response.schema, { ros2: true })).readMessage(response.data)
      : JSON.parse(new TextDecoder().decode(response.data));
  }
}

function decoded(channel, data) {
  if (channel.encoding === "json") return JSON.parse(new TextDecoder().decode(data));
  return new MessageReader(parse(channel.schema, { ros2: true })).readMessage(data);
}

function plain(value) {
  return JSON.parse(JSON.stringify(value, (_, item) => {
    if (typeof item === "bigint") return Number(item);
    if (ArrayBuffer.isView(item)) return Array.from(item, (one) => (Number.isFinite(one) ? one : String(one)));
    return typeof item === "number" && !Number.isFinite(item) ? String(item) : item;
  }));
}

async function ros(session) {
  const found = { sensors: {} };
  for (const topic of given.topics) {
    const subscription = await session.subscribe(topic);
    found.sensors[topic] = {
      encoding: subscription.channel.encoding,
      schemaName: subscription.channel.schemaName,
      value: plain(await session.next(subscription)),
    };
  }
  const heard = await session.subscribe("/twist_heard");
  const writer = new MessageWriter(parse(heard.channel.schema, { ros2: true }));
  const twist = { linear: { x: 0.25, y: 0, z: 0 }, angular: { x: 0, y: 0, z: -0.5 } };
  const channel = session.client.advertise({ topic: "/cmd_vel", encoding: "cdr", schemaName: "geometry_msgs/msg/Twist" });
  // Again and again, as somebody who drives: the robot's echo keeps only the newest.
  const driving = setInterval(() => session.client.sendMessage(channel, writer.writeMessage(twist)), 100);
  let echoed;
  do echoed = plain(await session.next(heard)); while (echoed.linear.x !== 0.25);
  clearInterval(driving);
  found.driven = echoed;
  do echoed = plain(await session.next(heard)); while (echoed.linear.x !== 0);
  found.stopped = true;
  session.client.unadvertise(channel);
  found.reset = plain(await session.call("/reset", {}, 1));
  found.add = plain(await session.call("/add", given.add, 2));
  found.refused = plain(await session.call("/set_bool", { data: false }, 3)); // it is so already
  return found;
}

async function rover(session) {
  const found = { channels: {} };
  for (const topic of given.topics) {
    const subscription = await session.subscribe(topic);
    found.channels[topic] = {
      schemaName: subscription.channel.schemaName,
      schema: JSON.parse(subscription.channel.schema),
      value: await session.next(subscription),
    };
  }
  const velocity = await session.subscribe("/sensor/velocity");
  const channel = session.client.advertise({ topic: "/actuator/cmd_vel", encoding: "json", schemaName: "Twist" });
  const data = new TextEncoder().encode(JSON.stringify({ linear: { x: 0.4 } }));
  const driving = setInterval(() => session.client.sendMessage(channel, data), 100);
  let speed = 0;
  while (speed < 0.2) speed = (await session.next(velocity)).linear.x;
  clearInterval(driving);
  while (speed > 0.02) speed = (await session.next(velocity)).linear.x;
  session.client.unadvertise(channel);
  found.stopped = true;
  found.reset = await session.call("/service/reset_system", {}, 1);
  return found;
}

async function common(session) {
  const found = {};
  session.client.getParameters(given.parameters, "get");
  found.parameters = (await session.event("parameterValues", (one) => one.id === "get")).parameters;
  session.client.subscribeParameterUpdates([given.set.name]);
  session.client.setParameters([given.set], "set");
  found.set = (await session.event("parameterValues", (one) => one.id === "set")).parameters;
  found.update = (await session.event("parameterValues", (one) => one.id === undefined)).parameters;
  session.client.subscribeConnectionGraph();
  const graph = await session.event("connectionGraphUpdate");
  found.published = graph.publishedTopics.map((one) => one.name);
  session.client.unsubscribeConnectionGraph();
  session.client.fetchAsset(given.asset, 5);
  const asset = await session.event("fetchAssetResponse", (one) => one.requestId === 5);
  found.asset = asset.status === 0 ? asset.data.byteLength : asset.error;
  session.socket.send("no operation");
  found.wrong = (await session.event("status", (one) => one.level === 2)).message;
  return found;
}

async function once() {
  const session = new Session(given.url, given.subprotocol);
  await session.event("open");
  const info = await session.event("serverInfo");
  const more = await { ros, rover }[given.robot](session);
  const found = { name: info.name, ...more, ...(await common(session)) };
  session.client.close();
  return found;
}

async function reconnected() {
  const ids = [];
  const deadline = Date.now() + 3 * PATIENCE; // two gateways start meanwhile
  while (ids.length < 2 && Date.now() < deadline) {
    const session = new Session(given.url, given.subprotocol);
    if ((await session.first("open", "close", "error")) !== "open") {
      await new Promise((resolve) => setTimeout(resolve, 100));
      continue;
    }
    ids.push((await session.event("serverInfo")).sessionId);
    await session.next(await session.subscribe(given.topics[0]));
    if (ids.length === 1) {
      process.stderr.write("ready\n");
      await session.first("close", "error");
    } else {
      session.client.close();
    }
  }
  return { ids };
}

const report = given.robot === "reconnect" ? await reconnected() : await once();
process.stdout.write(JSON.stringify(report), () => process.exit(0));
