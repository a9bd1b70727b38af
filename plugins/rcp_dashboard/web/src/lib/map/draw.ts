/** What lies above the map: robots with their tracks, homes, missions and fences, drawn on a canvas. */
import type { Geo } from "../geo.ts";
import { declutter } from "../labels.ts";
import { height } from "../units.svelte.ts";
import { type Fence, type Item, placed, wayOf } from "./items.ts";
import type { Handle } from "./plan.svelte.ts";
import type { Plane } from "./plane.ts";

export type Pen = CanvasRenderingContext2D;
type Colour = (name: string) => string;

export interface Track {
  name: string;
  at: Geo;
  /** deg, clockwise from north. */
  heading: number | undefined;
  trail: Geo[];
}

const KNOB = 7; // pixels

function path(pen: Pen, plane: Plane, places: Geo[]): void {
  pen.beginPath();
  for (const place of places) pen.lineTo(...plane.toScreen(place));
}

/** Write words that can be read on whatever lies below. */
function word(pen: Pen, text: string, x: number, y: number, colour: Colour): void {
  pen.lineWidth = 3;
  pen.strokeStyle = colour("--panel");
  pen.lineJoin = "round";
  pen.strokeText(text, x, y);
  pen.fillStyle = colour("--text");
  pen.fillText(text, x, y);
}

export function drawTrack(pen: Pen, plane: Plane, track: Track, own: string, colour: Colour): void {
  pen.strokeStyle = own;
  pen.lineWidth = 2;
  path(pen, plane, track.trail);
  pen.stroke();
  const [x, y] = plane.toScreen(track.at);
  pen.save();
  pen.translate(x, y);
  pen.rotate(((track.heading ?? 0) * Math.PI) / 180);
  pen.beginPath();
  if (track.heading === undefined) pen.arc(0, 0, 7, 0, 7);
  else for (const [px, py] of [[0, -13], [9, 10], [0, 5], [-9, 10]] as const) pen.lineTo(px, py);
  pen.closePath();
  pen.lineWidth = 3;
  pen.strokeStyle = colour("--panel");
  pen.stroke();
  pen.fillStyle = own;
  pen.fill();
  pen.restore();
}

const NAME = 14; // pixels of a letter's height
const ICON = 13; // pixels from a robot's place to the edge of its icon

/** Write the names of robots that have room, each beside its icon; returns the side of each, to be told with the next picture. */
export function drawNames(pen: Pen, plane: Plane, tracks: readonly Track[], before: ReadonlyMap<string, number>, colour: Colour): Map<string, number> {
  pen.font = `600 ${NAME}px system-ui, sans-serif`;
  const wishes = tracks
    .map(({ name, at }) => ({ name, at: plane.toScreen(at) }))
    .filter(({ at: [x, y] }) => x > -ICON && y > -ICON && x < plane.size.width + ICON && y < plane.size.height + ICON)
    .map(({ name, at: [x, y] }) => ({ key: name, x, y, width: pen.measureText(name).width, height: NAME * 1.2 }));
  const icons = wishes.map(({ x, y }) => ({ left: x - ICON, right: x + ICON, low: y - ICON, high: y + ICON }));
  const sides = declutter(wishes, ({ width, height }) => [[-(ICON + 1) / width, 0.5], [1 + (ICON + 1) / width, 0.5], [0.5, -(ICON + 1) / height], [0.5, 1 + (ICON + 1) / height]], icons, before);
  for (const { key, x, y, width, height } of wishes) {
    const side = sides.get(key);
    if (side === undefined) continue;
    const left = [x + ICON + 1, x - ICON - 1 - width, x - width / 2, x - width / 2][side]!;
    const middle = [y, y, y + ICON + 1 + height / 2, y - ICON - 1 - height / 2][side]!;
    word(pen, key, left, middle + NAME * 0.35, colour);
  }
  pen.canvas.dataset["named"] = String(sides.size);
  return sides;
}

/** Draw where something is to go. */
export function drawGoal(pen: Pen, x: number, y: number, colour: string): void {
  pen.strokeStyle = colour;
  pen.lineWidth = 3;
  pen.beginPath();
  pen.arc(x, y, 9, 0, 7);
  for (const [along, up] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
    pen.moveTo(x + 5 * along, y + 5 * up);
    pen.lineTo(x + 15 * along, y + 15 * up);
  }
  pen.stroke();
}

export function drawHome(pen: Pen, plane: Plane, at: Geo, own: string, colour: Colour): void {
  const [x, y] = plane.toScreen(at);
  pen.beginPath();
  for (const [px, py] of [[0, -11], [11, -1], [7, -1], [7, 9], [-7, 9], [-7, -1], [-11, -1]] as const) pen.lineTo(x + px, y + py);
  pen.closePath();
  pen.fillStyle = colour("--panel");
  pen.fill();
  pen.strokeStyle = own;
  pen.lineWidth = 2;
  pen.stroke();
}

export function drawFence(pen: Pen, plane: Plane, fence: Fence, open: boolean, selected: Handle | undefined, colour: Colour): void {
  pen.lineWidth = 2.5;
  pen.setLineDash(open ? [8, 6] : []);
  fence.areas.forEach(({ inside, corners, radius }, area) => {
    const own = (pen.strokeStyle = pen.fillStyle = inside ? colour("--warn") : colour("--bad"));
    path(pen, plane, corners);
    if (radius !== undefined) {
      const middle = corners[0]!;
      const [x, y] = plane.toScreen(middle);
      const [, top] = plane.toScreen({ latitude: middle.latitude + radius / 111_320, longitude: middle.longitude });
      pen.beginPath();
      pen.arc(x, y, Math.max(0, y - top), 0, 7);
    }
    pen.closePath();
    pen.stroke();
    if (!inside) {
      pen.globalAlpha = 0.2;
      pen.fill();
      pen.globalAlpha = 1;
    }
    if (open) corners.forEach((at, corner) => knob(pen, plane, at, own, "", selected?.what === "fence" && selected.area === area && selected.corner === corner, colour));
  });
  pen.setLineDash([]);
}

interface Shown {
  items: Item[];
  /** Whether it is being drawn. */
  open: boolean;
  home: Geo | undefined;
  selected: Handle | undefined;
  /** The item under way. */
  current: number | undefined;
}

/** Draw a mission, from home and back to it where it begins and ends there. */
export function drawMission(pen: Pen, plane: Plane, { items, open, home, selected, current }: Shown, colour: Colour): void {
  const own = colour("--accent");
  pen.strokeStyle = own;
  pen.lineWidth = 2.5;
  pen.setLineDash(open ? [8, 6] : []);
  path(pen, plane, wayOf(items, home));
  pen.stroke();
  pen.setLineDash([]);
  items.forEach((item, place) => {
    if (!placed(item)) return;
    knob(pen, plane, item, place === current ? colour("--good") : own, String(place + 1), selected?.what === "mission" && selected.item === place, colour);
    if (item.altitude === 0) return;
    const [x, y] = plane.toScreen(item);
    pen.font = "12px system-ui, sans-serif";
    word(pen, height(item.altitude), x + 12, y - 8, colour);
  });
}

function knob(pen: Pen, plane: Plane, at: Geo, own: string, text: string, chosen: boolean, colour: Colour): void {
  const [x, y] = plane.toScreen(at);
  pen.save();
  pen.setLineDash([]);
  pen.beginPath();
  pen.arc(x, y, text ? KNOB + 3 : KNOB, 0, 7);
  pen.fillStyle = chosen ? colour("--text") : colour("--panel");
  pen.fill();
  pen.strokeStyle = own;
  pen.lineWidth = 3;
  pen.stroke();
  pen.fillStyle = chosen ? colour("--panel") : colour("--text");
  pen.font = "600 11px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.fillText(text, x, y + 4);
  pen.restore();
}
