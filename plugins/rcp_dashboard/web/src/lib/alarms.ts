/** An alarm of a trigger, as `/system/alarms` tells it. */
export interface Alarm {
  alarm: string;
  trigger: string;
  robot: string;
  severity: "info" | "warning" | "critical";
  message: string;
  raised: string;
  last: string;
  state: "active" | "acknowledged" | "cleared" | "closed";
  count?: number;
  cleared?: string;
  acknowledged?: string;
  by?: string;
  comment?: string;
}

export const ALARMS = "/system/alarms";

/** Those that nobody has acknowledged. */
export function waiting(all: Alarm[]): Alarm[] {
  return all.filter((one) => one.state === "active" || one.state === "cleared");
}
