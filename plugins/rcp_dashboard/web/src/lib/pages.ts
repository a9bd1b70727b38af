import type { Component } from "svelte";

import Overview from "../pages/Overview.svelte";

export interface Page {
  id: string;
  name: string;
  /** An outline of 24 × 24, drawn by stroke. */
  icon: string;
  load: () => Promise<{ default: Component }>;
  /** Not worth to be fetched before it is wanted. */
  heavy?: boolean;
  /** A path without which the menu leaves it out. */
  needs?: string;
  /** Whether it can look at the past. */
  past?: true;
  /** Whether it moves robots, and so is for the present alone. */
  drives?: true;
}

/** The pages in the order of the menu; all but the first come when they are opened. */
export const PAGES: Page[] = [
  { id: "", name: "Overview", icon: "M4 4h7v7H4zM13 4h7v4h-7zM13 11h7v9h-7zM4 14h7v6H4z", load: async () => ({ default: Overview }) },
  { id: "fleet", name: "Fleet", icon: "M4 6h16M4 12h16M4 18h16M9 3v18", load: () => import("../pages/Fleet.svelte") },
  { id: "explore", name: "Explore", icon: "M4 5h6M4 12h10M4 19h6M14 5h6M18 12h2M14 19h6M10 3v4M14 10v4M14 17v4", load: () => import("../pages/Explore.svelte"), past: true },
  { id: "parameters", name: "Parameters", icon: "M4 7h9M17 7h3M15 5v4M4 12h3M11 12h9M9 10v4M4 17h11M19 17h1M17 15v4", load: () => import("../pages/Parameters.svelte") },
  { id: "teleop", name: "Teleop", icon: "M12 3v4M12 17v4M3 12h4M17 12h4M12 9a3 3 0 1 1 0 6a3 3 0 1 1 0-6", load: () => import("../pages/Teleop.svelte"), drives: true },
  { id: "camera", name: "Camera", icon: "M3 7h4l2-2h6l2 2h4v12H3zM12 9.5a3.5 3.5 0 1 1 0 7a3.5 3.5 0 1 1 0-7", load: () => import("../pages/Camera.svelte"), past: true },
  { id: "scene", name: "Scene", icon: "M12 3l8 4.5v9L12 21l-8-4.5v-9zM12 12l8-4.5M12 12v9M12 12L4 7.5", load: () => import("../pages/Scene.svelte"), heavy: true, past: true },
  { id: "map", name: "Map", icon: "M3 6l6-2l6 2l6-2v14l-6 2l-6-2l-6 2zM9 4v14M15 6v14", load: () => import("../pages/Map.svelte"), past: true },
  { id: "plot", name: "Plot", icon: "M4 4v16h16M7 15l4-5l3 3l5-7", load: () => import("../pages/Plot.svelte"), past: true },
  { id: "layout", name: "Layouts", icon: "M4 4h9v16H4zM13 4h7v7h-7zM13 11h7v9h-7z", load: () => import("../pages/Layouts.svelte"), needs: "/system/layouts", drives: true },
  { id: "commands", name: "Commands", icon: "M5 6l4 6l-4 6M12 18h7", load: () => import("../pages/Commands.svelte") },
  { id: "alarms", name: "Alarms", icon: "M6 17V11a6 6 0 0 1 12 0v6l2 2H4zM10 21h4M12 3v2", load: () => import("../pages/Alarms.svelte"), needs: "/system/alarms" },
  { id: "log", name: "Log", icon: "M5 5h14M5 10h14M5 15h9M5 20h6", load: () => import("../pages/Log.svelte"), past: true },
  { id: "recordings", name: "Recordings", icon: "M4 6h16v12H4zM8 6v12M16 6v12M4 10h4M4 14h4M16 10h4M16 14h4", load: () => import("../pages/Recordings.svelte"), needs: "/system/recorder" },
  { id: "people", name: "People", icon: "M9 11a3.5 3.5 0 1 0 0-7a3.5 3.5 0 0 0 0 7zM2.5 20c0-4 3-6 6.5-6s6.5 2 6.5 6M16 4.5a3.5 3.5 0 0 1 0 6.5M18 14.5c2.2.8 3.5 2.8 3.5 5.5", load: () => import("../pages/People.svelte") },
];
