// Reads a recording with @mcap/core, as Foxglove does, and prints what every channel has.
import { McapIndexedReader } from "@mcap/core";
import { open } from "node:fs/promises";
import { zstdDecompressSync } from "node:zlib";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const buffer = new Uint8Array(Number(length));
    await file.read(buffer, 0, Number(length), Number(offset));
    return buffer;
  },
};
const reader = await McapIndexedReader.Initialize({
  readable,
  decompressHandlers: { zstd: (data) => new Uint8Array(zstdDecompressSync(data)) },
});
const found = {};
for await (const message of reader.readMessages({ validateCrcs: true })) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  const one = (found[channel.topic] ??= {
    encoding: channel.messageEncoding,
    schema: schema.name,
    language: schema.encoding,
    messages: 0,
  });
  one.messages += 1;
  if (channel.messageEncoding === "json") {
    one.last = JSON.parse(new TextDecoder().decode(message.data));
    JSON.parse(new TextDecoder().decode(schema.data));
  }
}
console.log(JSON.stringify({ profile: reader.header.profile, channels: found }));
await file.close();
