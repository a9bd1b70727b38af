import type { Samples } from "./transforms.ts";

/** Columns of time and of each series, as they are drawn: a cell is empty where a series has no sample. */
export function csv(all: { name: string; series: Samples }[], from: number, to: number): string {
  const quoted = (text: string): string => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const rows = new Map<number, (number | undefined)[]>();
  all.forEach(({ series }, column) => {
    series.times.forEach((time, at) => {
      if (time < from || time > to) return;
      let row = rows.get(time);
      if (!row) rows.set(time, (row = all.map(() => undefined)));
      row[column] = series.values[at];
    });
  });
  const lines = [...rows].sort(([a], [b]) => a - b).map(([time, row]) => `${new Date(time * 1000).toISOString()},${row.map((one) => one ?? "").join(",")}`);
  return `${["time", ...all.map(({ name }) => quoted(name))].join(",")}\n${lines.join("\n")}\n`;
}

/** Hand a text to the person as a file. */
export function download(name: string, text: string, type: string): void {
  save(name, new Blob([text], { type }));
}

/** Hand bytes to the person as a file. */
export function save(name: string, data: Blob): void {
  const url = URL.createObjectURL(data);
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}
