/**
 * What is plotted, whatever page is shown: the plots, each a list of series (a path and a field with `#` between), with
 * `y=least..most` among them where the height is fixed.
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

  drop(at: number, series: string): void {
    const rest = (this.all[at] ?? []).filter((one) => one !== series);
    if (seriesOf(rest).length) this.all[at] = rest;
    else this.all.splice(at, 1);
  }

  /** Fix how high a plot is, or let it follow what is shown. */
  fix(at: number, low: number | undefined, high: number | undefined): void {
    const rest = seriesOf(this.all[at] ?? []);
    this.all[at] = low === undefined || high === undefined || low >= high ? rest : [...rest, `y=${low}..${high}`];
  }
}

export function seriesOf(plot: string[]): string[] {
  return plot.filter((one) => !one.startsWith("y="));
}

export function heightOf(plot: string[]): [number, number] | undefined {
  const found = plot.find((one) => one.startsWith("y="))?.slice(2).split("..").map(Number);
  return found?.length === 2 && found.every(Number.isFinite) ? (found as [number, number]) : undefined;
}

export const plots = new Plots();
