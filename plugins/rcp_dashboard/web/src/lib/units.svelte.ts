import { rounded, together } from "./format.ts";
import { keep, kept } from "./kept.ts";

const KEY = "rcp.units";

export type System = "metric" | "imperial";

interface Unit {
  name: string;
  /** How many of it are one of the metric unit. */
  factor: number;
  offset?: number;
}

/** What stands for a metric unit, as the gateway names it. Speeds are in mph, also those of aircraft: distances are in miles. */
const IMPERIAL: Record<string, Unit> = {
  m: { name: "ft", factor: 1 / 0.3048 },
  cm: { name: "in", factor: 1 / 2.54 },
  mm: { name: "in", factor: 1 / 25.4 },
  km: { name: "mi", factor: 1 / 1.609344 },
  "m/s": { name: "mph", factor: 3.6 / 1.609344 },
  "km/h": { name: "mph", factor: 1 / 1.609344 },
  "m/s2": { name: "ft/s²", factor: 1 / 0.3048 },
  "m/s3": { name: "ft/s³", factor: 1 / 0.3048 },
  kg: { name: "lb", factor: 1 / 0.45359237 },
  Cel: { name: "°F", factor: 1.8, offset: 32 },
};
/** Units whose names people do not use. */
const METRIC: Record<string, string> = { Cel: "°C", "Cel/s": "°C/s", "m/s2": "m/s²", "m/s3": "m/s³", "rad/s2": "rad/s²", "rad/s3": "rad/s³" };

/** The units in which lengths, speeds, weights and temperatures are shown and typed. On the wire all are metric. */
class Units {
  system = $state<System>(kept(KEY) === "imperial" ? "imperial" : "metric");

  choose(system: System): void {
    this.system = system;
    keep(KEY, system, "computer");
  }

  name(unit: string): string {
    return this.#of(unit)?.name ?? METRIC[unit] ?? unit;
  }

  /** A value of a metric unit, in the one that is shown. */
  shown(value: number, unit: string): number {
    const other = this.#of(unit);
    return other ? value * other.factor + (other.offset ?? 0) : value;
  }

  /** What was typed in the unit that is shown, in the metric one. */
  meant(value: number, unit: string): number {
    const other = this.#of(unit);
    // 100 ft are 30.48 m, not 30.480000000000004.
    return other ? Number(((value - (other.offset ?? 0)) / other.factor).toFixed(9)) : value;
  }

  /** A value as a box to type in holds it. */
  box(value: number, unit: string): number {
    return Number(this.shown(value, unit).toFixed(this.system === "metric" ? 9 : 2));
  }

  #of(unit: string): Unit | undefined {
    if (this.system === "metric") return undefined;
    if (Object.hasOwn(IMPERIAL, unit)) return IMPERIAL[unit];
    // A rate of change: of a temperature, it has no zero to be counted from.
    const base = unit.endsWith("/s") ? this.#of(unit.slice(0, -2)) : undefined;
    return base && { name: `${base.name}/s`, factor: base.factor };
  }
}

export const units = new Units();

/** A value of a metric unit with so many decimals, and the unit beside it. */
export function measured(value: number, unit: string, digits: number): string {
  return `${rounded(units.shown(value, unit), digits)} ${units.name(unit)}`;
}

/** Values of one unit beside each other. */
export function measuredAll(values: number[], unit: string, digits: number): string {
  return `${together(values.map((one) => rounded(units.shown(one, unit), digits)))} ${units.name(unit)}`;
}

/** With no more decimals than it has. */
export function height(metres: number): string {
  const value = units.shown(metres, "m");
  return rounded(value, Number.isInteger(value) || units.system === "imperial" ? 0 : 1) + ` ${units.name("m")}`;
}

/** A way, near or far. */
export function distance(metres: number): string {
  const far = units.shown(metres / 1000, "km");
  return metres < (units.system === "imperial" ? 1609.344 : 1000) ? measured(metres, "m", 0) : `${rounded(far, 2)} ${units.name("km")}`;
}
