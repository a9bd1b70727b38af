import { CanvasTexture, Sprite, SpriteMaterial } from "three";

const LETTER = 44; // pixels of a letter's height before it is drawn small
const LINE = 1.4; // heights of a letter from one line to the next

/** Words that face whoever looks; its scale of one is a letter's line, and `wide` says how much wider it is. */
export interface Words {
  object: Sprite;
  wide: number;
  lines: number;
}

/** Write words with an edge around them, so that they can be read on anything. */
export function words(text: string, fill: string, edge: string, options: { attenuated: boolean; above: boolean; opacity?: number }): Words {
  const lines = text.split("\n").slice(0, 8);
  const canvas = document.createElement("canvas");
  const font = `600 ${LETTER}px system-ui, sans-serif`;
  let pen = canvas.getContext("2d")!;
  pen.font = font;
  canvas.width = Math.min(4096, Math.ceil(Math.max(...lines.map((line) => pen.measureText(line).width))) + 12);
  canvas.height = Math.ceil(LETTER * LINE * lines.length);
  pen = canvas.getContext("2d")!;
  pen.font = font;
  pen.textBaseline = "middle";
  pen.lineWidth = 7;
  pen.lineJoin = "round";
  pen.strokeStyle = edge;
  pen.fillStyle = fill;
  lines.forEach((line, at) => {
    const y = (at + 0.5) * LETTER * LINE;
    pen.strokeText(line, 6, y);
    pen.fillText(line, 6, y);
  });
  const { attenuated, above, opacity = 1 } = options;
  const object = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), sizeAttenuation: attenuated, depthTest: !above, depthWrite: false, opacity }));
  if (above) object.renderOrder = 10;
  return { object, wide: canvas.width / (LETTER * LINE), lines: lines.length };
}
