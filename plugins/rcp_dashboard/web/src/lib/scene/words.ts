import { CanvasTexture, LinearFilter, Sprite, SpriteMaterial } from "three";

const LETTER = 44; // pixels of a letter's height before it is drawn small
const NAME = 13; // pixels of a letter's height in a name, which is of one size however far away it is
/** Pixels from one line of names to the next. */
export const NAME_LINE = NAME * 1.4;
const FINER = 2; // as many pixels as on the screen: a name lies between them
const LINE = 1.4; // heights of a letter from one line to the next

/** Words that face whoever looks; its scale of one is a letter's line, and `wide` says how much wider it is. */
export interface Words {
  object: Sprite;
  wide: number;
  lines: number;
}

/** Write words with an edge around them, so that they can be read on anything. */
export function words(text: string, fill: string, edge: string, options: { attenuated: boolean; above: boolean; opacity?: number }): Words {
  const { attenuated, above, opacity = 1 } = options;
  const letter = attenuated ? LETTER : Math.round(NAME * FINER * devicePixelRatio);
  const lines = text.split("\n").slice(0, 8);
  const canvas = document.createElement("canvas");
  const font = `600 ${letter}px system-ui, sans-serif`;
  let pen = canvas.getContext("2d")!;
  pen.font = font;
  canvas.width = Math.min(4096, Math.ceil(Math.max(...lines.map((line) => pen.measureText(line).width))) + letter / 3.5);
  canvas.height = Math.ceil(letter * LINE * lines.length);
  pen = canvas.getContext("2d")!;
  pen.font = font;
  pen.textBaseline = "middle";
  pen.lineWidth = letter / 6;
  pen.lineJoin = "round";
  pen.strokeStyle = edge;
  pen.fillStyle = fill;
  lines.forEach((line, at) => {
    const y = (at + 0.5) * letter * LINE;
    pen.strokeText(line, letter / 7, y);
    pen.fillText(line, letter / 7, y);
  });
  const map = new CanvasTexture(canvas);
  // Smaller pictures of it, between which one would be chosen, are softer than the name need be.
  if (!attenuated) [map.minFilter, map.generateMipmaps] = [LinearFilter, false];
  const object = new Sprite(new SpriteMaterial({ map, sizeAttenuation: attenuated, depthTest: !above, depthWrite: false, opacity }));
  if (above) object.renderOrder = 10;
  return { object, wide: canvas.width / (letter * LINE), lines: lines.length };
}
