/** Catalogues of texts as PO files, which translators' programs read and write. */
import type { Text } from "./texts.ts";

export interface Entry extends Text {
  /** The translation; two or more where a number decides; empty: there is none yet. */
  told: string[];
  /** Where the text is. */
  files: string[];
}

const keyOf = ({ one, many }: Text): string => (many === undefined ? one : `${one}\0${many}`);

/** Read a PO file: its header, with the comments above it, and its entries. */
export function read(po: string): { header: string; entries: Map<string, Entry> } {
  const [header = "", ...blocks] = po.trim().split(/\n{2,}/);
  const entries = new Map<string, Entry>();
  for (const block of blocks) {
    const entry: Entry = { one: "", told: [], files: [] };
    for (const line of block.split("\n")) {
      const [, word, at, text] = /^(msgid|msgid_plural|msgstr)(?:\[(\d+)\])? (".*")$/.exec(line) ?? [];
      if (line.startsWith("#: ")) entry.files.push(...line.slice(3).split(" "));
      else if (word === undefined) throw new Error(`not a line of a catalogue: ${line}`);
      else if (word === "msgid") entry.one = unquoted(text!);
      else if (word === "msgid_plural") entry.many = unquoted(text!);
      else entry.told[Number(at ?? 0)] = unquoted(text!);
    }
    entries.set(keyOf(entry), entry);
  }
  return { header, entries };
}

/** Write a PO file, with the entries in the order of their texts: two branches that add some rarely meet. */
export function write(header: string, entries: Iterable<Entry>): string {
  const sorted = [...entries].sort((a, b) => (keyOf(a) < keyOf(b) ? -1 : 1));
  return `${[header, ...sorted.map(block)].join("\n\n")}\n`;
}

function block({ one, many, told, files }: Entry): string {
  const lines = [`#: ${files.join(" ")}`, `msgid ${quoted(one)}`];
  if (many === undefined) lines.push(`msgstr ${quoted(told[0] ?? "")}`);
  else lines.push(`msgid_plural ${quoted(many)}`, ...told.map((text, at) => `msgstr[${at}] ${quoted(text)}`));
  return lines.join("\n");
}

/** Bring a catalogue to the texts that there are now: what is new has no translation, what is gone is left out. */
export function merged(old: Map<string, Entry>, texts: Iterable<Text & { file: string }>, forms: number): Map<string, Entry> {
  const made = new Map<string, Entry>();
  for (const { file, ...text } of texts) {
    const key = keyOf(text);
    const entry = made.get(key) ?? { ...text, told: old.get(key)?.told ?? Array<string>(text.many === undefined ? 1 : forms).fill(""), files: [] };
    if (!entry.files.includes(file)) entry.files.push(file);
    made.set(key, entry);
  }
  return made;
}

/** What is wrong with an entry; empty: nothing. */
export function fault({ one, many, told }: Entry): string {
  if (told.length === 0 || told.some((text) => text === "")) return "not translated";
  const holes = (text: string): string => [...new Set(text.match(/\{\d+\}/g))].sort().join(" ");
  if (many === undefined && holes(one) !== holes(told[0]!)) return `its places are ${holes(one) || "none"}, those of the translation ${holes(told[0]!) || "none"}`;
  if (many === undefined && (one.startsWith(" ") !== told[0]!.startsWith(" ") || one.endsWith(" ") !== told[0]!.endsWith(" "))) return "it begins or ends with a space, and its translation does not, or the other way round";
  return "";
}

/** What the page loads: the translations by the texts of the source. */
export function compiled(entries: Map<string, Entry>): Record<string, string | string[]> {
  const done = [...entries.values()].filter((entry) => fault(entry) === "");
  return Object.fromEntries(done.map((entry) => [keyOf(entry), entry.many === undefined ? entry.told[0]! : entry.told]));
}

const quoted = (text: string): string => JSON.stringify(text);
const unquoted = (text: string): string => JSON.parse(text) as string;
