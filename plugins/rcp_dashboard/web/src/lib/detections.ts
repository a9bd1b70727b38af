/** What was detected in a camera's image: `vision_msgs/Detection2DArray`. */
import type { Resource } from "rcp-client";

import { caption, classOf, hueOf } from "./scene/asmarkers.ts";
import { many } from "./words.ts";

export const MOST = 200; // boxes that are drawn over one image
export const OLD = 1; // s between an image and what was detected before it is not drawn

/** A box in pixels of the image, about its middle. */
export interface Found {
  x: number;
  y: number;
  width: number;
  height: number;
  /** Clockwise, rad. */
  turned: number;
  text: string;
  hue: readonly [number, number, number];
}

/** The boxes of a message, and what is wrong with the others. */
export function foundIn(value: any): { boxes: Found[]; problem: string } {
  const list = value?.detections;
  if (!Array.isArray(list)) return { boxes: [], problem: "it has no detections" };
  const boxes: Found[] = [];
  let wrong = 0;
  for (const one of list.slice(0, MOST)) {
    const { center, size_x: width, size_y: height } = one?.bbox ?? {};
    const { x, y } = center?.position ?? center ?? {};
    const turned = center?.theta ?? 0;
    if (![x, y, width, height, turned].every(Number.isFinite) || width < 0 || height < 0) {
      wrong += 1;
      continue;
    }
    const told = classOf(one);
    boxes.push({ x, y, width, height, turned, text: caption(told), hue: hueOf(told.label) });
  }
  const left = Math.max(0, list.length - MOST);
  const problem = [wrong > 0 && `${many(wrong, "box is", "boxes are")} not drawn: no number, or a negative size`, left > 0 && `${many(left, "more box is", "more boxes are")} not drawn: ${MOST} is the most`].filter(Boolean).join("; ");
  return { boxes, problem };
}

const frameOf = (value: any): string => String(value?.header?.frame_id ?? value?.frame_id ?? "");
const folder = (path: string): string => path.slice(0, path.lastIndexOf("/"));

/** Whether what was detected is of this image: by their frames, else because they stand side by side or there is `only` one camera. */
export function belongs(image: { resource: Resource; value: any }, found: { resource: Resource; value: any }, only: boolean): boolean {
  const [a, b] = [frameOf(image.value), frameOf(found.value)];
  return a && b ? a === b : only || folder(image.resource.path) === folder(found.resource.path);
}

const SHARP = 640; // pixels from which on words can be read

/** How many pixels the drawing needs for one of an image. */
export const finer = (width: number): number => Math.max(1, Math.ceil(SHARP / width));

/** Draw the boxes with their classes and scores on a canvas that has so many pixels for each of the image. */
export function drawFound(pen: CanvasRenderingContext2D, boxes: readonly Found[], scale: number): void {
  const [width, height] = [pen.canvas.width / scale, pen.canvas.height / scale];
  const thick = Math.max(1.5 / scale, width / 320);
  const letter = Math.max(11 / scale, Math.min(width, height) / 26);
  pen.setTransform(scale, 0, 0, scale, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineWidth = thick;
  pen.font = `600 ${letter}px system-ui, sans-serif`;
  pen.textBaseline = "middle";
  for (const box of boxes) {
    const [r, g, b] = box.hue.map((one) => Math.round(one * 255));
    pen.strokeStyle = pen.fillStyle = `rgb(${r} ${g} ${b})`;
    pen.save();
    pen.translate(box.x, box.y);
    pen.rotate(box.turned);
    pen.strokeRect(-box.width / 2, -box.height / 2, box.width, box.height);
    pen.restore();
    const wide = pen.measureText(box.text).width + letter * 0.6;
    const tall = letter * 1.3;
    const reach = [Math.abs(Math.cos(box.turned)) * box.width + Math.abs(Math.sin(box.turned)) * box.height, Math.abs(Math.sin(box.turned)) * box.width + Math.abs(Math.cos(box.turned)) * box.height] as const;
    const left = Math.min(Math.max(0, box.x - reach[0] / 2), Math.max(0, width - wide));
    const above = box.y - reach[1] / 2 - tall;
    const top = Math.min(above >= 0 ? above : Math.max(0, box.y - reach[1] / 2), height - tall);
    pen.fillRect(left, top, wide, tall);
    pen.fillStyle = "#10151b";
    pen.fillText(box.text, left + letter * 0.3, top + tall / 2);
  }
}
