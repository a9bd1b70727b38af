/** Bytes of a value: base64 in JSON, as they are in MessagePack. */
export function bytesOf(value: string | Uint8Array): Uint8Array<ArrayBuffer> {
  if (typeof value !== "string") return value as Uint8Array<ArrayBuffer>;
  const binary = atob(value);
  const made = new Uint8Array(binary.length);
  for (let at = 0; at < binary.length; at++) made[at] = binary.charCodeAt(at);
  return made;
}

export function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}
