import { Moment } from "rcp-client";

const TICK = 1000; // ms
const JUMP = 4000; // ms between two ticks that no busy page takes

/** Call back when this page may have slept: it is seen again, the network is there again, or time has jumped. */
export function onWake(told: () => void): void {
  const seen = (): void => {
    if (!document.hidden) told();
  };
  let last = new Moment();
  setInterval(() => {
    const passed = last.passed;
    last = new Moment();
    if (passed > JUMP) seen(); // the timers of a hidden tab are slow as well, and that is no sleep
  }, TICK);
  for (const kind of ["online", "focus", "pageshow"]) addEventListener(kind, seen);
  for (const kind of ["visibilitychange", "resume"]) document.addEventListener(kind, seen);
}
