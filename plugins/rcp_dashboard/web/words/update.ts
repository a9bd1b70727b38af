/** Bring the catalogues to the texts of the source, and list what has to be translated. */
import { readdirSync, readFileSync, writeFileSync } from "node:fs";

import { fault, merged, read, write } from "./catalogue.ts";
import { collect, has } from "./collect.ts";

const here = new URL(".", import.meta.url);
const src = new URL("../src/", here);
const files = readdirSync(src, { recursive: true, encoding: "utf8" }).map((one) => one.replaceAll("\\", "/")).filter((one) => has(`/${one}`));
const { texts, early } = collect(files.map((one) => [`src/${one}`, readFileSync(new URL(one, src), "utf8")]));
for (const name of readdirSync(here).filter((one) => one.endsWith(".po"))) {
  const file = new URL(name, here);
  const { header, entries } = read(readFileSync(file, "utf8"));
  const forms = new Intl.PluralRules(name.replace(".po", "")).resolvedOptions().pluralCategories.length;
  const now = merged(entries, texts, forms);
  writeFileSync(file, write(header, now.values()));
  for (const entry of now.values()) if (fault(entry)) console.log(`${name}: ${fault(entry)}: ${JSON.stringify(entry.one)}`);
}
for (const text of early) console.log(`read when its module is loaded, before the language is known: put it into a function or object: ${text}`);
