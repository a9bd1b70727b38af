import { checkedPlots } from "../plots.svelte.ts";

/** What a panel shows, in the order in which they are offered. */
export const KINDS = ["camera", "scene", "map", "plot", "teleop", "joints", "log", "commands", "value", "gauge", "form", "parameters", "note", "plugin"] as const;
export type Kind = (typeof KINDS)[number];

/** A panel, with what it is about; which of the fields it has is its kind's. */
export interface Panel {
  /** Told apart within its page only. */
  id: number;
  kind: Kind;
  /** Its part of the height of its column, in relation to the others. */
  size: number;
  title?: string;
  robot?: string;
  path?: string;
  field?: string;
  low?: number;
  high?: number;
  text?: string;
  plots?: string[][];
  seconds?: number;
  /** The name of a plugin's panel, and the path of each of its inputs and outputs. */
  plugin?: string;
  paths?: Record<string, string>;
}

export interface Column {
  /** Its part of the width of the page, in relation to the others. */
  size: number;
  panels: Panel[];
}

export interface Layout {
  columns: Column[];
}

export const LEAST = 0.15; // of the mean size: what is smaller cannot be used
const MOST = 24; // panels
const FEW = 3; // columns that new panels make
const LONG = 4096; // characters
const NOTE = 20_000; // characters
let made = 0;

const record = (one: unknown): Record<string, unknown> => (typeof one === "object" && one !== null && !Array.isArray(one) ? (one as Record<string, unknown>) : {});
const list = (one: unknown): unknown[] => (Array.isArray(one) ? one : []);
const sizeOf = (one: unknown): number => (typeof one === "number" && one > 0 && one < 1000 ? one : 1);

/** A new panel. */
export function panelOf(kind: Kind, more: Partial<Panel> = {}): Panel {
  return { size: 1, ...more, kind, id: ++made };
}

function panel(found: unknown): Panel | undefined {
  const given = record(found);
  const kind = KINDS.find((one) => one === given["kind"]);
  if (!kind) return undefined;
  const kept: Partial<Panel> = { size: sizeOf(given["size"]) };
  for (const name of ["title", "robot", "path", "field", "plugin"] as const) if (typeof given[name] === "string" && given[name].length < LONG) kept[name] = given[name];
  for (const name of ["low", "high"] as const) if (typeof given[name] === "number" && Number.isFinite(given[name])) kept[name] = given[name];
  if (typeof given["text"] === "string") kept.text = given["text"].slice(0, NOTE);
  if (kind === "plot") Object.assign(kept, checkedPlots(given));
  const paths = Object.entries(record(given["paths"])).filter(([, path]) => typeof path === "string" && path.length < LONG);
  if (paths.length) kept.paths = Object.fromEntries(paths) as Record<string, string>;
  return panelOf(kind, kept);
}

/** What of a document is a layout: another version of the page, or somebody by hand, may have written it. */
export function checked(found: unknown): Layout {
  let left = MOST;
  const columns = list(record(found)["columns"]).map((one) => {
    const panels = list(record(one)["panels"]).map(panel).filter((each) => each !== undefined).slice(0, left);
    left -= panels.length;
    return { size: sizeOf(record(one)["size"]), panels };
  });
  return cleaned(columns);
}

/** The layout as it is kept. */
export function content({ columns }: Layout): Record<string, unknown> {
  return { columns: columns.map(({ size, panels }) => ({ size, panels: panels.map(({ id: _, ...kept }) => kept) })) };
}

export function panelsOf(layout: Layout): Panel[] {
  return layout.columns.flatMap((one) => one.panels);
}

export function full(layout: Layout): boolean {
  return panelsOf(layout).length >= MOST;
}

function cleaned(columns: Column[]): Layout {
  return { columns: columns.filter((one) => one.panels.length > 0) };
}

/** The layout with one more panel: in a column of its own while there are few, then below the shortest one. */
export function added(layout: Layout, one: Panel): Layout {
  if (full(layout)) return layout;
  const { columns } = layout;
  if (columns.length < FEW) return { columns: [...columns, { size: 1, panels: [one] }] };
  const shortest = columns.reduce((best, each) => (each.panels.length < best.panels.length ? each : best));
  return { columns: columns.map((each) => (each === shortest ? { ...each, panels: [...each.panels, one] } : each)) };
}

export function removed({ columns }: Layout, id: number): Layout {
  return cleaned(columns.map((column) => ({ ...column, panels: column.panels.filter((one) => one.id !== id) })));
}

export function changed({ columns }: Layout, id: number, change: Partial<Panel>): Layout {
  return { columns: columns.map((column) => ({ ...column, panels: column.panels.map((one) => (one.id === id ? { ...one, ...change } : one)) })) };
}

export type Direction = "left" | "right" | "up" | "down";

/** The layout with a panel one place further; beyond the first and the last column it gets one of its own. */
export function moved(layout: Layout, id: number, to: Direction): Layout {
  const columns = layout.columns.map((column) => ({ ...column, panels: [...column.panels] }));
  const at = columns.findIndex((column) => column.panels.some((one) => one.id === id));
  const column = columns[at];
  if (!column) return layout;
  const place = column.panels.findIndex((one) => one.id === id);
  const one = column.panels[place] as Panel;
  if (to === "up" || to === "down") {
    const next = place + (to === "up" ? -1 : 1);
    if (next < 0 || next >= column.panels.length) return layout;
    [column.panels[place], column.panels[next]] = [column.panels[next] as Panel, one];
    return { columns };
  }
  const next = columns[at + (to === "left" ? -1 : 1)];
  if (!next && column.panels.length === 1) return layout;
  column.panels.splice(place, 1);
  if (next) next.panels.splice(Math.min(place, next.panels.length), 0, one);
  else columns.splice(to === "left" ? 0 : columns.length, 0, { size: 1, panels: [one] });
  return cleaned(columns);
}

/** Sizes with the border behind one of them moved by a part of their sum; both beside it keep a least size. */
export function shifted(sizes: number[], at: number, by: number): number[] {
  const [one, two] = [sizes[at], sizes[at + 1]];
  if (one === undefined || two === undefined) return sizes;
  const sum = sizes.reduce((all, size) => all + size, 0);
  const least = Math.min((LEAST * sum) / sizes.length, (one + two) / 2);
  const first = Math.max(least, Math.min(one + two - least, one + by * sum));
  return sizes.map((size, place) => (place === at ? first : place === at + 1 ? one + two - first : size));
}
