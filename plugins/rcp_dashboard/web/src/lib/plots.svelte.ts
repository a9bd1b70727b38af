import { units } from "./units.svelte.ts";

/**
 * What is plotted, whatever page is shown: the plots, each a list of series (a path and a field with `#` between, see
 * `lineOf`), with `y=least..most` among them where the height is fixed, and `xy` where the first is the axis of the others.
 */
class Plots {
  all = $state<string[][]>([]);
  seconds = $state(30);

  /** Add a series as a plot of its own, or into one that is there. */
  add(series: string, at = this.all.length): void {
    const plot = this.all[at];
    if (!plot) this.all.push([series]);
    else if (!plot.includes(series)) plot.push(series);
  }

  /** Put another plot in the place of one; without a series it goes. */
  set(at: number, plot: string[]): void {
    if (seriesOf(plot).length) this.all[at] = plot;
    else this.all.splice(at, 1);
  }
}

export function seriesOf(plot: string[]): string[] {
  return plot.filter((one) => one.includes("#") && !one.startsWith("y="));
}

export function heightOf(plot: string[]): [number, number] | undefined {
  const found = plot.find((one) => one.startsWith("y="))?.slice(2).split("..").map(Number);
  return found?.length === 2 && found.every(Number.isFinite) ? (found as [number, number]) : undefined;
}

/** Where the axis at this place is fixed, in the unit that is shown: only the first is, in whose unit it was typed. */
export function rangeAt(plot: string[], at: number, unit: string): [number, number] | undefined {
  // 100 ft, and not 99.99999999999999: the axis would end before its last number.
  return at === 0 ? (heightOf(plot)?.map((one) => Number(units.shown(one, unit).toPrecision(12))) as [number, number] | undefined) : undefined;
}

/** Whether its first series is the axis of the others, in place of time. */
export function crossed(plot: string[]): boolean {
  return plot.includes("xy") && seriesOf(plot).length > 1;
}

/** The plot without a series. */
export function dropped(plot: string[], series: string): string[] {
  return plot.filter((one) => one !== series);
}

/** The plot as high as this, or as what is shown. */
export function fixed(plot: string[], low: number | undefined, high: number | undefined): string[] {
  const rest = plot.filter((one) => !one.startsWith("y="));
  return low === undefined || high === undefined || low >= high ? rest : [...rest, `y=${low}..${high}`];
}

/** The plot with another series in the place of one. */
export function replaced(plot: string[], series: string, other: string): string[] {
  return [...new Set(plot.map((one) => (one === series ? other : one)))];
}

/** The plot over time, or with its first series as the axis. */
export function turned(plot: string[]): string[] {
  return plot.includes("xy") ? plot.filter((one) => one !== "xy") : [...plot, "xy"];
}

const MOST = 50; // plots, and lines of one
const LONGEST = 1800; // s
const DEFAULT = 30; // s

/** What of a document are plots: another version of the page, or somebody by hand, may have written it. */
export function checkedPlots(found: unknown): { plots: string[][]; seconds: number } {
  const { plots, seconds } = (found ?? {}) as Record<string, unknown>;
  const texts = (one: unknown): string[] => (Array.isArray(one) ? one : []).filter((line) => typeof line === "string" && line.length < 4096);
  const kept = (Array.isArray(plots) ? plots : []).map((one) => [...new Set(texts(one))].slice(0, MOST)).filter((one) => seriesOf(one).length > 0);
  return { plots: kept.slice(0, MOST), seconds: typeof seconds === "number" && seconds > 0 && seconds <= LONGEST ? seconds : DEFAULT };
}

export const plots = new Plots();
