/** Which parameters are shown. */
import type { Editor } from "./editor.svelte.ts";
import { agrees, type Assigned } from "./files.ts";
import { matches, type Parameter } from "./parameter.ts";
import { same } from "./value.ts";

export const SHOWS = ["all", "changed", "pending", "file"] as const;
export type Show = (typeof SHOWS)[number];

export interface View {
  text: string;
  /** "": of all groups. */
  group: string;
  show: Show;
}

export const ALL: View = { text: "", group: "", show: "all" };

/** Whether a value is not the default; not where either is not known. */
export function changed(one: Parameter, editor: Editor): boolean {
  const now = editor.valueOf(one.path);
  return one.default !== undefined && now !== undefined && !same(now, one.default);
}

/** What of a file is compared. */
export type Compared = Pick<Assigned, "values" | "decimals">;

/** Whether a file has another value than this. */
export function differs(one: Parameter, now: unknown, file: Compared | undefined): boolean {
  return file !== undefined && file.values.has(one.path) && (now === undefined || !agrees(now, file.values.get(one.path), file.decimals.get(one.path)));
}

/** The parameters that a view shows, in their order. */
export function shownOf(all: Parameter[], view: View, editor: Editor, file: Compared | undefined): Parameter[] {
  const words = view.text.toLowerCase().split(/\s+/).filter(Boolean);
  const suits: Record<Show, (one: Parameter) => boolean> = {
    all: () => true,
    changed: (one) => changed(one, editor),
    pending: (one) => editor.pending.has(one.path),
    file: (one) => differs(one, editor.valueOf(one.path), file),
  };
  return all.filter((one) => (!view.group || one.group === view.group) && matches(one, words) && suits[view.show](one));
}
