// Run by tests/clients/test_late.py: tells each new value of one path, whatever becomes of the gateway at RCP_URL.
import { Client } from "../src/index.ts";

const client = new Client({ url: process.env["RCP_URL"] as string, ping: 0.2 });
let last: unknown;
await client.connect();
client.subscribe(process.env["RCP_PATH"] as string, {}, {
  update: ({ body }) => {
    if (body !== last) console.log(String((last = body)));
  },
  ended: (error) => {
    console.log(`ended: ${error?.code}`);
    process.exit(1);
  },
});
