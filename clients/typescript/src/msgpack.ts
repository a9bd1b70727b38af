import { Decoder, Encoder } from "@msgpack/msgpack";

import type { Codec } from "./wire.ts";

/** A number where JavaScript has it exactly, else its digits: as the protocol has it in JSON. */
function exact(value: bigint): number | string {
  const number = Number(value);
  return Number.isSafeInteger(number) ? number : value.toString();
}

class Whole extends Decoder {}
// The library has numbers that may be wrong, or a bigint for each that took eight bytes: neither will do.
const read: Record<string, (this: { view: DataView; pos: number }) => number | string> = {
  readU64AsBigInt() {
    this.pos += 8;
    return exact(this.view.getBigUint64(this.pos - 8));
  },
  readI64AsBigInt() {
    this.pos += 8;
    return exact(this.view.getBigInt64(this.pos - 8));
  },
};
Object.assign(Whole.prototype, read);

const decoder = new Whole({ useBigInt64: true });
const encoder = new Encoder({ ignoreUndefined: true });

/** MessagePack: bytes come and go as `Uint8Array`, views of the message that brought them. */
export const msgpack: Codec = {
  name: "msgpack",
  encode: (value) => encoder.encode(value) as Uint8Array<ArrayBuffer>,
  decode: (data) => decoder.decode(data),
};
