/** Recordings as the gateway lists them, and when what they are of happened. */

export interface Recording {
  path: string;
  name: string;
  tenant: string;
  state: "recording" | "kept";
  start: string;
  end?: string;
  bytes: number;
  messages: number;
  paths?: string[];
  pinned?: boolean;
  recovered?: boolean;
  reason?: string;
  robot?: string;
  /** When an incident happened, where the gateway tells. */
  at?: string;
}

/** One or several incidents at nearly the same place of the time line. */
export interface Mark {
  at: number;
  incidents: Recording[];
}

export const INCIDENT = "incident";
/** When an incident happened, ms; where that is not told, when what is kept of it begins. */
export function momentOf(one: Recording): number {
  return Date.parse(one.at ?? one.start);
}

/** Incidents in the order of time. */
export function incidentsOf(all: Recording[]): Recording[] {
  return all.filter((one) => one.name === INCIDENT).sort((a, b) => momentOf(a) - momentOf(b));
}

/** Incidents of a span, those that lie too near to each other together. */
export function marksOf(incidents: Recording[], from: number, to: number, near: number): Mark[] {
  const marks: Mark[] = [];
  for (const one of incidents) {
    const at = momentOf(one);
    if (at < from || at > to) continue;
    const last = marks.at(-1);
    if (last && at - last.at < near) last.incidents.push(one);
    else marks.push({ at, incidents: [one] });
  }
  return marks;
}

/** Where something was recorded in a span, as parts of it from 0 to 1; gaps shorter than `near` ms are closed. */
export function stretches(all: Recording[], from: number, to: number, near: number): { from: number; to: number }[] {
  const spans = all
    .map((one) => ({ from: Date.parse(one.start), to: one.end ? Date.parse(one.end) : to }))
    .filter((one) => one.to > from && one.from < to)
    .sort((a, b) => a.from - b.from);
  const joined: { from: number; to: number }[] = [];
  for (const one of spans) {
    const last = joined.at(-1);
    if (last && one.from - last.to <= near) last.to = Math.max(last.to, one.to);
    else joined.push({ ...one });
  }
  const place = (time: number): number => Math.min(1, Math.max(0, (time - from) / (to - from)));
  return joined.map((one) => ({ from: place(one.from), to: place(one.to) }));
}
