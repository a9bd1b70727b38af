import { jointsOf } from "../joints.ts";
import { type Robot, steerable, vitals } from "../robots.ts";
import { properties, unitOf } from "../schema.ts";
import { ofShape } from "../shapes.ts";
import { type Layout, type Panel, panelOf } from "./document.ts";

const CHARGES = ["percentage", "battery_remaining", "remaining"];

/** Gauges of what every operator looks at. */
function gauges(robot: Robot): Panel[] {
  const { battery } = vitals(robot);
  const field = battery && CHARGES.find((one) => properties(battery).has(one));
  if (!battery || !field) return [];
  const percent = unitOf(battery, field) === "%" || field === "battery_remaining";
  return [panelOf("gauge", { title: "Battery", path: battery.path, field, low: 0, high: percent ? 100 : 1, size: 0.8 })];
}

/** What is worth a plot: speeds, else joints, else the height. */
function plotted(robot: Robot): Panel[] {
  const at = vitals(robot);
  const odometry = ofShape(robot.resources, "odometry")[0];
  const name = robot.name;
  const twist = odometry && (JSON.stringify(odometry.schemas?.value ?? {}).includes("covariance") ? "twist.twist" : "twist");
  if (odometry) return [panelOf("plot", { robot: name, seconds: 30, plots: [[`${odometry.path}#${twist}.linear.x`, `${odometry.path}#${twist}.angular.z`]] })];
  if (at.geo && properties(at.geo).has("relative_alt")) return [panelOf("plot", { robot: name, seconds: 60, plots: [[`${at.geo.path}#relative_alt`]] })];
  return [];
}

/** A layout to begin with, of what the profiles of a robot give it. */
export function layoutOf(robot: Robot): Layout {
  const { resources, name } = robot;
  const at = vitals(robot);
  const camera = ofShape(resources, "image").find((one) => one.operations.includes("subscribe"));
  const places: Panel[] = [];
  if (camera) places.push(panelOf("camera", { path: camera.path, size: 1.4 }));
  if (at.geo) places.push(panelOf("map", { robot: name, size: 1.4 }));
  else if (ofShape(resources, "pose").length || ofShape(resources, "transforms").length) places.push(panelOf("scene", { robot: name }));
  if (!camera) places.push(...plotted(robot));
  if (places.length === 0 && at.joints) places.push(panelOf("value", { path: at.joints.path }));
  const moves: Panel[] = [];
  if (resources.some(steerable)) moves.push(panelOf("teleop", { robot: name }));
  if (resources.some((one) => jointsOf(one) !== undefined)) moves.push(panelOf("joints", { robot: name }));
  const state = [...(camera ? plotted(robot) : []), ...gauges(robot)];
  if (at.mode) state.push(panelOf("value", { path: at.mode.path, size: 0.8 }));
  if (state.length === 0 && at.joints && places.length > 0) state.push(panelOf("value", { path: at.joints.path, size: 1.5 }));
  state.push(panelOf("log", { robot: name }));
  const columns = [
    { size: 1.5, panels: places },
    { size: 1.1, panels: moves },
    { size: 1, panels: state },
  ];
  return { columns: columns.filter((one) => one.panels.length > 0) };
}
