/** Files of parameters: `.param` of Mission Planner and MAVProxy, `.params` of QGroundControl, and JSON. */
import { parse } from "../schema.ts";
import type { Parameter } from "./parameter.ts";
import { same } from "./value.ts";

const MOST = 10_000; // parameters
const COLUMNS = 5; // of QGroundControl: vehicle, component, name, value, type
/** What a vehicle itself keeps: counters, versions and measurements, as backends/rcp_mavlink/parameter_files.py has them. */
const STATE = /^(_HASH_CHECK|FORMAT_VERSION|SYSID_SW_MREV|SYS_NUM_RESETS|STAT_.*|.*_TOTAL|CMD_INDEX|LOG_LASTFILE|GND_ABS_PRESS|GND_TEMP|BARO.*_GND_PRESS)$/;

const COARSE = 6; // decimals that MAVProxy writes; Mission Planner has seven digits
const EXACT = 9; // digits that tell a number of 32 bits from its neighbours

export interface ParameterFile {
  name: string;
  values: Map<string, unknown>;
  /** The decimals of those numbers that the file has rounded. */
  decimals: Map<string, number>;
  /** What could not be read of it. */
  faults: string[];
}

/** Read a file of any kind. */
export function parameterFile(name: string, text: string): ParameterFile {
  const content = text.replace(/^\uFEFF/, "");
  const found: ParameterFile = { name, values: new Map(), decimals: new Map(), faults: [] };
  if (content.trimStart().startsWith("{")) readJson(content, found);
  else readLines(content, found);
  if (found.values.size > MOST) return { ...found, values: new Map(), faults: [`The file has more than ${MOST} parameters.`] };
  if (found.values.size === 0 && found.faults.length === 0) found.faults.push("The file has no parameters.");
  return found;
}

function readLines(text: string, { values, decimals, faults }: ParameterFile): void {
  for (const [at, line] of text.split(/\r?\n/).entries()) {
    const content = line.split("#")[0]?.trim() ?? "";
    if (content === "") continue;
    let columns = content.split(/[\s,]+/);
    if (columns.length === COLUMNS) columns = columns.slice(2, 4);
    const [name, value] = columns;
    const number = Number(value);
    if (columns.length !== 2 || !name || !Number.isFinite(number)) faults.push(`Line ${at + 1} is no parameter: ${content.slice(0, 60)}`);
    else if (values.has(name) && values.get(name) !== number) faults.push(`Line ${at + 1} has another value of ${name} than a line before it.`);
    else {
      values.set(name, number);
      const rounded = decimalsOf(value as string);
      if (rounded !== undefined) decimals.set(name, rounded);
    }
  }
}

/** The decimals of a number that is written with so many that it is a rounded one; undefined: it is meant as it stands. */
function decimalsOf(text: string): number | undefined {
  const [, whole, part] = /^[-+]?(\d*)\.(\d+)$/.exec(text) ?? [];
  if (whole === undefined || part === undefined) return undefined;
  const digits = `${whole}${part}`.replace(/^0+/, "").length;
  return digits < EXACT && (part.length >= COARSE || digits > COARSE) ? part.length : undefined;
}

/** Whether a robot's value is that of a file, as far as the file has its digits. */
export function agrees(now: unknown, filed: unknown, decimals: number | undefined): boolean {
  if (same(now, filed)) return true;
  return decimals !== undefined && typeof now === "number" && typeof filed === "number" && Math.abs(now - filed) <= 0.5000001 * 10 ** -decimals;
}

/** The values of a file by the paths of a robot. */
export interface Assigned {
  values: Map<string, unknown>;
  decimals: Map<string, number>;
  /** The names that the robot does not have. */
  unknown: string[];
}

function readJson(text: string, { values, faults }: ParameterFile): void {
  try {
    const whole = parse(text) as Record<string, unknown>;
    const inner = whole["parameters"];
    const named = typeof inner === "object" && inner !== null && !Array.isArray(inner) ? (inner as Record<string, unknown>) : whole;
    for (const [name, value] of Object.entries(named)) values.set(name, value);
  } catch (problem) {
    faults.push(`The file is no JSON: ${(problem as Error).message}`);
  }
}

/** The values of a file by the paths of a robot's parameters, and the names that it does not have. */
export function assigned(file: ParameterFile, parameters: Parameter[]): Assigned {
  const byName = new Map(parameters.map((one) => [one.name, one]));
  const byOwn = new Map<string, Parameter | undefined>();
  // Two nodes may have parameters of one name: then it tells neither.
  for (const one of parameters) if (one.own !== undefined) byOwn.set(one.own, byOwn.has(one.own) ? undefined : one);
  const values = new Map<string, unknown>();
  const decimals = new Map<string, number>();
  const unknown: string[] = [];
  for (const [name, value] of file.values) {
    const one = byName.get(name) ?? byOwn.get(name);
    if (!one) {
      unknown.push(name);
      continue;
    }
    values.set(one.path, value);
    const rounded = file.decimals.get(name);
    if (rounded !== undefined) decimals.set(one.path, rounded);
  }
  return { values, decimals, unknown };
}

/** Whether the device itself keeps a parameter, so that it is not to be taken from a file with all others. */
export function isState(one: Parameter): boolean {
  return STATE.test(one.own ?? one.name);
}

/** Write parameters as JSON. */
export function toJson(robot: string, values: Iterable<[name: string, value: unknown]>, time: string): string {
  return `${JSON.stringify({ robot, time, parameters: Object.fromEntries(values) }, null, 2)}\n`;
}
