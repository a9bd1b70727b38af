import type { Samples } from "./transforms.ts";

/** Numbers over time: a ring that grows to a bound, handed out as arrays in the order of time. */
export class Series {
  static readonly MOST = 100_000;
  /** s: more than what is told again to who comes back. */
  static readonly BACK = 120;
  #times = new Float64Array(1024);
  #values = new Float64Array(1024);
  #from = 0;
  #to = 0;

  /** Add a value at a time in seconds; what is not newer than the last is left out, unless the source's clock was set back. */
  push(time: number, value: number): void {
    if (this.#to > this.#from && time < (this.#times[this.#to - 1] as number) - Series.BACK) this.#from = this.#to;
    if (this.#to > this.#from && time <= (this.#times[this.#to - 1] as number)) return;
    if (this.#to === this.#times.length) this.#room();
    this.#times[this.#to] = time;
    this.#values[this.#to++] = value;
  }

  /** Forget all. */
  clear(): void {
    this.#from = this.#to = 0;
  }

  /** Put what was before the first value in front of it; both in the order of time. */
  prepend(times: number[], values: number[]): void {
    const first = this.#to > this.#from ? (this.#times[this.#from] as number) : Infinity;
    const found = times.findIndex((time) => time >= first);
    const count = found < 0 ? times.length : found;
    if (count === 0) return;
    const [newer, numbers] = [this.times, this.values];
    const size = Math.max(1024, (count + newer.length) * 2);
    const [all, those] = [new Float64Array(size), new Float64Array(size)];
    all.set(times.slice(0, count));
    those.set(values.slice(0, count));
    all.set(newer, count);
    those.set(numbers, count);
    [this.#times, this.#values, this.#from, this.#to] = [all, those, 0, count + newer.length];
  }

  /** The last value at or before a time. */
  at(time: number): number | undefined {
    return valueAt(this, time);
  }

  #room(): void {
    const kept = Math.min(this.#to - this.#from, Series.MOST);
    const size = Math.max(1024, kept * 2);
    const [times, values] = [new Float64Array(size), new Float64Array(size)];
    times.set(this.#times.subarray(this.#to - kept, this.#to));
    values.set(this.#values.subarray(this.#to - kept, this.#to));
    [this.#times, this.#values, this.#from, this.#to] = [times, values, 0, kept];
  }

  /** Forget what is older than a time. */
  trim(time: number): void {
    while (this.#from < this.#to && (this.#times[this.#from] as number) < time) this.#from++;
  }

  get times(): Float64Array {
    return this.#times.subarray(this.#from, this.#to);
  }

  get values(): Float64Array {
    return this.#values.subarray(this.#from, this.#to);
  }
}

/** The last value at or before a time. */
export function valueAt({ times, values }: Samples, time: number): number | undefined {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((times[middle] as number) <= time) low = middle + 1;
    else high = middle;
  }
  return values[low - 1];
}

/** Put several series on one axis of time, as uPlot wants them; thinned to at most `most` points of time each. */
export function joined(all: Samples[], from: number, to: number, most: number): [number[], ...(number | null)[][]] {
  const picked = all.map((series) => thin(series, from, to, most));
  if (picked.length === 1) return [picked[0]!.times, picked[0]!.values];
  const axis = [...new Set(picked.flatMap((one) => one.times))].sort((a, b) => a - b);
  const rows = picked.map(({ times, values }) => {
    let at = 0;
    // Undefined where this series has no sample: uPlot joins over those, and breaks the line at null.
    return axis.map((time) => (times[at] === time ? (values[at++] as number) : undefined)) as (number | null)[];
  });
  return [axis, ...rows];
}

/** The least and the greatest of each bucket: peaks stay, however many samples there are. */
function thin(series: Samples, from: number, to: number, most: number): { times: number[]; values: number[] } {
  const { times, values } = series;
  const place = (time: number): number => {
    let [low, high] = [0, times.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if ((times[middle] as number) < time) low = middle + 1;
      else high = middle;
    }
    return low;
  };
  // One beyond either end, so that the line reaches it.
  const first = Math.max(0, place(from) - 1);
  const end = Math.min(times.length, place(to) + 1);
  const count = end - first;
  if (count <= most) return { times: [...times.subarray(first, end)], values: [...values.subarray(first, end)] };
  const size = Math.ceil((count / most) * 2);
  const out: { times: number[]; values: number[] } = { times: [], values: [] };
  // Buckets begin at fixed places of the ring, else the picture would shimmer as it moves.
  for (let start = first - (first % size); start < end; start += size) {
    let low = Math.max(start, first);
    let high = low;
    for (let at = low; at < Math.min(start + size, end); at++) {
      if ((values[at] as number) < (values[low] as number)) low = at;
      if ((values[at] as number) > (values[high] as number)) high = at;
    }
    for (const at of low === high ? [low] : low < high ? [low, high] : [high, low]) {
      out.times.push(times[at] as number);
      out.values.push(values[at] as number);
    }
  }
  return out;
}
