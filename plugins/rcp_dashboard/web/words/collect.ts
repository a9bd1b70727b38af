/** The texts of all pages. */
import { type Text, translate } from "./texts.ts";

export interface Texts {
  texts: (Text & { file: string })[];
  /** Texts that are read once when their module is loaded, with their files. */
  early: string[];
}

/** What holds texts of the pages; the look-up itself has none. */
export const has = (file: string): boolean => /\.(svelte|ts)$/.test(file) && !file.endsWith("/language.svelte.ts");

/** Collect the texts of files, given as their names and sources. */
export function collect(files: Iterable<[string, string]>): Texts {
  const all: Texts = { texts: [], early: [] };
  for (const [file, source] of [...files].sort(([a], [b]) => (a < b ? -1 : 1))) {
    if (!has(file)) continue;
    const { texts, early } = translate(source, file);
    all.texts.push(...texts.map((text) => ({ ...text, file })));
    all.early.push(...early.map((text) => `${file}: ${text}`));
  }
  return all;
}
