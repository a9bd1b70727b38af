import type { Resource } from "rcp-client";
import type { Component } from "svelte";

import { jointsOf } from "../joints.ts";
import { drivable, type Robot, steerable } from "../robots.ts";
import { ofShape, shapes } from "../shapes.ts";
import type { Kind, Panel } from "./document.ts";

/** What every panel is given. */
export interface PanelProps {
  panel: Panel;
  /** Whether keyboard and gamepad are this panel's. */
  active: boolean;
  /** Whether it must not move anything for now: it is out of sight, or the layout is being edited. */
  locked: boolean;
  change: (change: Partial<Panel>) => void;
}

export type Setting = "robot" | "path" | "field" | "range" | "text" | "plots" | "paths";

interface About {
  name: string;
  /** What is to be chosen, in this order. */
  settings: Setting[];
  robot?: (robot: Robot) => boolean;
  /** Whether it may be about all robots. */
  all?: true;
  path?: (resource: Resource) => boolean;
  load: () => Promise<{ default: Component<PanelProps> }>;
}

const readable = (one: Resource): boolean => one.operations.includes("subscribe") && one.path.startsWith("/tenant/");
const placed = ({ resources }: Robot): boolean => ["pose", "transforms", "ned"].some((shape) => ofShape(resources, shape as "pose").length > 0);

/** The kinds of panels; what each needs comes when one is shown. */
export const ABOUT: Record<Kind, About> = {
  camera: { name: "Camera", settings: ["path"], path: (one) => readable(one) && shapes(one).has("image"), load: () => import("../../panels/CameraPanel.svelte") },
  scene: { name: "Scene", settings: ["robot"], robot: placed, load: () => import("../../panels/ScenePanel.svelte") },
  map: { name: "Map", settings: ["robot"], all: true, robot: ({ resources }) => ofShape(resources, "geo").length > 0, load: () => import("../../panels/MapPanel.svelte") },
  plot: { name: "Plot", settings: ["plots"], load: () => import("../../panels/PlotPanel.svelte") },
  teleop: { name: "Teleop", settings: ["robot", "path"], robot: ({ resources }) => resources.some(steerable), path: steerable, load: () => import("../../panels/TeleopPanel.svelte") },
  joints: { name: "Joints", settings: ["robot"], robot: (one) => drivable(one) && one.resources.some((each) => jointsOf(each) !== undefined), load: () => import("../../panels/JointsPanel.svelte") },
  log: { name: "Log", settings: ["robot"], all: true, robot: () => true, load: () => import("../../panels/LogPanel.svelte") },
  commands: { name: "Commands", settings: ["robot"], all: true, robot: () => true, load: () => import("../../panels/CommandsPanel.svelte") },
  value: { name: "Value", settings: ["path"], path: (one) => readable(one) && !shapes(one).has("image"), load: () => import("../../panels/ValuePanel.svelte") },
  gauge: { name: "Gauge", settings: ["path", "field", "range"], path: (one) => readable(one) && one.kind !== "event" && !shapes(one).has("image"), load: () => import("../../panels/GaugePanel.svelte") },
  form: { name: "Form", settings: ["path"], path: (one) => one.path.startsWith("/tenant/") && (one.operations.includes("write") || one.operations.includes("execute")), load: () => import("../../panels/FormPanel.svelte") },
  parameters: { name: "Parameters", settings: ["robot"], robot: ({ resources }) => resources.some((one) => one.kind === "param"), load: () => import("../../panels/ParametersPanel.svelte") },
  note: { name: "Note", settings: ["text"], load: () => import("../../panels/NotePanel.svelte") },
  plugin: { name: "Plugin", settings: ["paths"], load: () => import("../../panels/PluginPanel.svelte") },
};

/** What a panel is called: by its title, else by its kind and what it is about. */
export function titleOf(panel: Panel): string {
  const about = panel.robot || panel.path?.split("/").slice(3).join("/");
  return panel.title || `${panel.kind === "plugin" ? (panel.plugin ?? "Plugin") : ABOUT[panel.kind].name}${about ? ` · ${about}` : ""}`;
}
