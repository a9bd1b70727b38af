// The official JavaScript clients drive the simulated rover; prints what they met as JSON.
// Arguments: modern | legacy, the address, the agent's key.
const [era, url, key] = process.argv.slice(2);
const requestInit = { headers: key ? { Authorization: `Bearer ${key}` } : {} };
const identity = { name: "drive", version: "1.0.0" };
const capabilities = { elicitation: { form: {} } };
const met = {};
let questions = [];
let answer = { action: "accept", content: { approve: true } };
const onQuestion = async (request) => {
  questions.push(request.params.message);
  return answer;
};

async function connected(init) {
  if (era === "modern") {
    const { Client, StreamableHTTPClientTransport } = await import("@modelcontextprotocol/client");
    const client = new Client(identity, {
      capabilities,
      versionNegotiation: { mode: { pin: "2026-07-28" } },
    });
    client.setRequestHandler("elicitation/create", onQuestion);
    await client.connect(new StreamableHTTPClientTransport(new URL(url), { requestInit: init }));
    return { client, call: (params, options) => client.callTool(params, options) };
  }
  const { Client } = await import("@modelcontextprotocol/sdk/client/index.js");
  const { StreamableHTTPClientTransport } = await import(
    "@modelcontextprotocol/sdk/client/streamableHttp.js"
  );
  const types = await import("@modelcontextprotocol/sdk/types.js");
  const client = new Client(identity, { capabilities });
  client.setRequestHandler(types.ElicitRequestSchema, onQuestion);
  await client.connect(new StreamableHTTPClientTransport(new URL(url), { requestInit: init }));
  return { client, call: (params, options) => client.callTool(params, undefined, options) };
}

const { client, call } = await connected(requestInit);
const tools = (await client.listTools()).tools;
met.tools = tools.map((tool) => tool.name);

const found = await call({ name: "discover", arguments: { q: "pose" } });
met.discovered = found.structuredContent.resources.map((one) => one.path);

const pose = await call({ name: "read", arguments: { path: "/sensor/pose" } });
met.pose = pose.structuredContent.values[0].value.position;

const camera = await call({ name: "read", arguments: { path: "/sensor/camera" } });
met.pictures = camera.content.filter((one) => one.type === "image").map((one) => one.mimeType);

const resource = await client.readResource({ uri: "rcp://alpha/sensor/pose" });
met.resource = JSON.parse(resource.contents[0].text).path;
met.templates = (await client.listResourceTemplates()).resourceTemplates.length;
met.prompts = (await client.listPrompts()).prompts.map((one) => one.name);

const progress = [];
const moved = await call(
  { name: "action-move_to", arguments: { position: { x: 0.8, y: 0 } } },
  { onprogress: (one) => progress.push(one.progress), timeout: 30000 },
);
met.moved = moved.structuredContent.status;
met.progress = progress;

const leaving = new AbortController();
const given = call(
  { name: "action-move_to", arguments: { position: { x: -3, y: 0 } } },
  { signal: leaving.signal, onprogress: () => leaving.abort("enough"), timeout: 30000 },
);
met.cancelled = await given.then(
  () => false,
  () => true,
);
for (let tries = 0; tries < 200; tries++) {
  const status = await call({ name: "status", arguments: {} });
  met.running = status.structuredContent.running.length;
  if (met.running === 0) break;
  await new Promise((done) => setTimeout(done, 50));
}

const denied = await call({ name: "write", arguments: { path: "/param/speed_limit", value: 9 } });
met.denied = [denied.isError, denied.structuredContent.error.code];

met.approved = await call({ name: "service-reset_system", arguments: {} });
met.approved = met.approved.structuredContent.status;
met.question = questions;
answer = { action: "decline" };
const declined = await call({ name: "service-clear_faults", arguments: {} });
met.declined = [declined.isError, declined.structuredContent.error?.code];

const guest = await connected({});
const refused = await guest.call({
  name: "execute",
  arguments: { path: "/tenant/alpha/action/dock" },
});
met.guest = [refused.isError, refused.structuredContent.error.code];
await guest.client.close();
await client.close();
console.log(JSON.stringify(met));
