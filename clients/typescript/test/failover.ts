// Run by tests/backends/fleet/test_failover.py: RCP_URL has two hubs, of which the first is killed while a command runs.
import { Client } from "../src/index.ts";

const client = new Client({ url: process.env["RCP_URL"] as string, token: process.env["RCP_TOKEN"] as string, ping: 0.2 });
const first = client.connect();
const { session } = await first;
const command = client.execute(process.env["RCP_GO"] as string, 1);
let other = false;
client.onChange(() => {
  if (other || client.state !== "open" || client.hello?.session === session) return;
  other = true;
  console.log("other hub");
});
client.subscribe(process.env["RCP_COUNT"] as string, {}, { update: ({ body }) => console.log(`count ${body}`) });
await command.accepted;
console.log("accepted");
console.log(`result ${await command.result}`);
client.close();
