import { type Geo, round, toGeo } from "./geo.ts";

interface Place {
  x: number;
  y: number;
}

/** What of a plane in metres, east and north, is seen in a box of pixels. */
export class Plane {
  centre: Place = { x: 0, y: 0 };
  scale = 4; // pixels in a metre
  size = { width: 0, height: 0 };

  toScreen(at: Place): [number, number] {
    return [this.size.width / 2 + (at.x - this.centre.x) * this.scale, this.size.height / 2 - (at.y - this.centre.y) * this.scale];
  }

  at(px: number, py: number): Place {
    return { x: this.centre.x + (px - this.size.width / 2) / this.scale, y: this.centre.y - (py - this.size.height / 2) / this.scale };
  }

  move(px: number, py: number): void {
    this.centre = { x: this.centre.x - px / this.scale, y: this.centre.y + py / this.scale };
  }

  /** Come closer, or go farther, with what is at a pixel staying there. */
  zoom(by: number, px = this.size.width / 2, py = this.size.height / 2): void {
    const before = this.at(px, py);
    this.scale = Math.min(200, Math.max(1e-4, this.scale * by));
    const after = this.at(px, py);
    this.centre = { x: this.centre.x + before.x - after.x, y: this.centre.y + before.y - after.y };
  }

  fit(places: Place[]): void {
    if (places.length === 0) return;
    const [xs, ys] = [places.map((one) => one.x), places.map((one) => one.y)];
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    this.centre = { x: (x0 + x1) / 2, y: (y0 + y1) / 2 };
    this.scale = Math.min(8, (0.7 * this.size.width) / Math.max(1, x1 - x0), (0.7 * this.size.height) / Math.max(1, y1 - y0));
  }

  /** Draw lines of longitude and latitude, how long a metre is and where north is. */
  grid(pen: CanvasRenderingContext2D, origin: Geo, colour: (name: string) => string): void {
    const { width, height } = this.size;
    const step = round(110 / this.scale);
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--dim");
    pen.lineWidth = 1;
    pen.font = "12px system-ui, sans-serif";
    const [low, high] = [this.at(0, height), this.at(width, 0)];
    pen.beginPath();
    for (let x = Math.ceil(low.x / step) * step; x <= high.x; x += step) {
      const [px] = this.toScreen({ x, y: 0 });
      pen.moveTo(px, 0);
      pen.lineTo(px, height);
      pen.fillText(toGeo(x, 0, origin).longitude.toFixed(5), px + 4, height - 6);
    }
    for (let y = Math.ceil(low.y / step) * step; y <= high.y; y += step) {
      const [, py] = this.toScreen({ x: 0, y });
      pen.moveTo(0, py);
      pen.lineTo(width, py);
      pen.fillText(toGeo(0, y, origin).latitude.toFixed(5), 6, py + 14);
    }
    pen.stroke();
    pen.fillStyle = colour("--text");
    pen.fillRect(width - 20 - step * this.scale, height - 34, step * this.scale, 3);
    pen.textAlign = "right";
    pen.fillText(step >= 1000 ? `${step / 1000} km` : `${step} m`, width - 20, height - 40);
    pen.fillText("N ↑", width - 20, 24);
    pen.textAlign = "left";
  }
}

/** Draw where something is to go. */
export function drawGoal(pen: CanvasRenderingContext2D, x: number, y: number, colour: string): void {
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
