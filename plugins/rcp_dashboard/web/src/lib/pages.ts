import type { Component } from "svelte";

import Overview from "../pages/Overview.svelte";

export interface Page {
  id: string;
  name: string;
  /** An outline of 24 × 24, drawn by stroke. */
  icon: string;
  load: () => Promise<{ default: Component }>;
}

/** The pages in the order of the menu; all but the first come when they are opened. */
export const PAGES: Page[] = [
  { id: "", name: "Overview", icon: "M4 4h7v7H4zM13 4h7v4h-7zM13 11h7v9h-7zM4 14h7v6H4z", load: async () => ({ default: Overview }) },
  { id: "explore", name: "Explore", icon: "M4 5h6M4 12h10M4 19h6M14 5h6M18 12h2M14 19h6M10 3v4M14 10v4M14 17v4", load: () => import("../pages/Explore.svelte") },
  { id: "commands", name: "Commands", icon: "M5 6l4 6l-4 6M12 18h7", load: () => import("../pages/Commands.svelte") },
  { id: "log", name: "Log", icon: "M5 5h14M5 10h14M5 15h9M5 20h6", load: () => import("../pages/Log.svelte") },
];
