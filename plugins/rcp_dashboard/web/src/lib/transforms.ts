/** Values at times in seconds, in the order of time. */
export interface Samples {
  readonly times: Float64Array;
  readonly values: Float64Array;
}

/** What is drawn of a field: its values, their rate of change per second, or their mean over the last seconds. */
export type Shown = { what: "value" } | { what: "rate" } | { what: "mean"; seconds: number };

/** A line of a plot: a path and a field with `#` between, and behind `~` what is drawn of it: `rate`, or `mean` and seconds. */
export interface Line {
  id: string;
  path: string;
  field: string;
  shown: Shown;
}

export const MEANS = [1, 5, 30]; // s
const LONGEST = 600; // s

export function lineOf(id: string): Line {
  const hash = id.indexOf("#");
  const found = /^(.*)~(?:(rate)|mean(\d+(?:\.\d+)?))$/.exec(id.slice(hash + 1));
  const field = found?.[1] ?? id.slice(hash + 1);
  const seconds = Number(found?.[3]);
  const shown: Shown = found?.[2] ? { what: "rate" } : found && seconds > 0 && seconds <= LONGEST ? { what: "mean", seconds } : { what: "value" };
  return { id, path: id.slice(0, hash), field, shown };
}

/** How a line is written that shows something else of the same field. */
export function written({ path, field }: Line, shown: Shown): string {
  const behind = { value: "", rate: "~rate", mean: shown.what === "mean" ? `~mean${shown.seconds}` : "" };
  return `${path}#${field}${behind[shown.what]}`;
}

/** The unit of what is drawn of a field that has a unit, or none. */
export function unitShown(unit: string, shown: Shown): string {
  if (shown.what !== "rate") return unit;
  const per = /^(.*\/s)([23]?)$/.exec(unit);
  return per ? `${per[1]}${Number(per[2] || 1) + 1}` : `${unit || "1"}/s`;
}

/** How much before a span is needed to draw what is shown of it, in s. */
export function before(shown: Shown): number {
  return shown.what === "mean" ? shown.seconds : 0;
}

/** The part between two times, with one sample before it. */
export function within({ times, values }: Samples, from: number, to: number): Samples {
  const first = Math.max(0, place(times, from) - 1);
  const end = place(times, to) + 1;
  return { times: times.subarray(first, end), values: values.subarray(first, end) };
}

/** The slope of the line between each sample and the one before it, per second, at the time of the later one. */
export function rate({ times, values }: Samples): Samples {
  const count = Math.max(0, times.length - 1);
  const out = { times: new Float64Array(count), values: new Float64Array(count) };
  for (let at = 0; at < count; at++) {
    out.times[at] = times[at + 1]!;
    out.values[at] = (values[at + 1]! - values[at]!) / (times[at + 1]! - times[at]!);
  }
  return out;
}

/** The mean of the samples of the last `seconds` up to each one; what is no number is left out of it. */
export function mean({ times, values }: Samples, seconds: number): Samples {
  const out = new Float64Array(times.length);
  let [first, sum, count] = [0, 0, 0];
  const add = (value: number, sign: 1 | -1): void => {
    if (!Number.isFinite(value)) return;
    sum += sign * value;
    count += sign;
  };
  for (let at = 0; at < times.length; at++) {
    add(values[at]!, 1);
    while (times[first]! <= times[at]! - seconds) add(values[first++]!, -1);
    out[at] = sum / count;
  }
  return { times, values: out };
}

/** What a line shows of its samples. */
export function shownOf(samples: Samples, shown: Shown): Samples {
  return shown.what === "rate" ? rate(samples) : shown.what === "mean" ? mean(samples, shown.seconds) : samples;
}

/** Two fields against each other: at each time of the one the other between its samples, where both are known. */
export function paired(x: Samples, y: Samples): { xs: number[]; ys: number[] } {
  const [xs, ys]: [number[], number[]] = [[], []];
  let next = 0;
  x.times.forEach((time, at) => {
    while (next < y.times.length && y.times[next]! < time) next++;
    if (next >= y.times.length || (next === 0 && y.times[0] !== time)) return;
    const [t1, v1] = [y.times[next]!, y.values[next]!];
    const part = t1 === time ? 1 : (time - y.times[next - 1]!) / (t1 - y.times[next - 1]!);
    const from = t1 === time ? 0 : y.values[next - 1]!;
    xs.push(x.values[at]!);
    ys.push(from + (v1 - from) * part);
  });
  return { xs, ys };
}

/** The first place whose time is not before a time. */
function place(times: Float64Array, time: number): number {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! < time) low = middle + 1;
    else high = middle;
  }
  return low;
}
