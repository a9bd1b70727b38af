import type { Layout } from "./document.ts";

/** A layout that was changed and not saved, with the version that it was made from. */
export interface Draft {
  layout: Layout;
  version: number;
}

/** What was changed stays while other pages are looked at, as long as this one is open. */
const drafts = new Map<string, Draft>();

export function draftOf(key: string): Draft | undefined {
  return drafts.get(key);
}

export function keepDraft(key: string, draft: Draft): void {
  drafts.set(key, draft);
}

export function dropDraft(key: string): void {
  drafts.delete(key);
}
