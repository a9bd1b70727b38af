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
}

/** The pages in the order of the menu; all but the first come when they are opened. */
export const PAGES: Page[] = [
  { id: "", name: "Overview", icon: "M4 4h7v7H4zM13 4h7v4h-7zM13 11h7v9h-7zM4 14h7v6H4z", load: async () => ({ default: Overview }) },
  { id: "explore", name: "Explore", icon: "M4 5h6M4 12h10M4 19h6M14 5h6M18 12h2M14 19h6M10 3v4M14 10v4M14 17v4", load: () => import("../pages/Explore.svelte") },
  { id: "teleop", name: "Teleop", icon: "M12 3v4M12 17v4M3 12h4M17 12h4M12 9a3 3 0 1 1 0 6a3 3 0 1 1 0-6", load: () => import("../pages/Teleop.svelte") },
  { id: "camera", name: "Camera", icon: "M3 7h4l2-2h6l2 2h4v12H3zM12 9.5a3.5 3.5 0 1 1 0 7a3.5 3.5 0 1 1 0-7", load: () => import("../pages/Camera.svelte") },
  { id: "scene", name: "Scene", icon: "M12 3l8 4.5v9L12 21l-8-4.5v-9zM12 12l8-4.5M12 12v9M12 12L4 7.5", load: () => import("../pages/Scene.svelte"), heavy: true },
  { id: "map", name: "Map", icon: "M3 6l6-2l6 2l6-2v14l-6 2l-6-2l-6 2zM9 4v14M15 6v14", load: () => import("../pages/Map.svelte") },
  { id: "plot", name: "Plot", icon: "M4 4v16h16M7 15l4-5l3 3l5-7", load: () => import("../pages/Plot.svelte") },
  { id: "commands", name: "Commands", icon: "M5 6l4 6l-4 6M12 18h7", load: () => import("../pages/Commands.svelte") },
  { id: "log", name: "Log", icon: "M5 5h14M5 10h14M5 15h9M5 20h6", load: () => import("../pages/Log.svelte") },
];
