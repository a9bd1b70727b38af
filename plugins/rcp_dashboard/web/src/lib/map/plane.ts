import { rounded } from "../format.ts";
import { type Geo, round } from "../geo.ts";
import { units } from "../units.svelte.ts";

const TILE = 512; // pixels of the map of the world at zoom 0
const EQUATOR = 2 * Math.PI * 6_378_137; // m
const POLE = 85.051_128; // deg: farther from the equator the map does not reach
const MOST = 23; // of zoom
const BEGIN = 4; // pixels in a metre
const NEAREST = 8; // pixels in a metre, where all is to be shown

interface Spot {
  x: number;
  y: number;
}

const rad = (degrees: number): number => (degrees * Math.PI) / 180;
const kept = (latitude: number): number => Math.min(POLE, Math.max(-POLE, latitude));

/** Where a place is on the map of the world, in parts of its side from the upper left corner. */
function spotOf(at: Geo): Spot {
  const y = 0.5 - Math.log(Math.tan(Math.PI / 4 + rad(kept(at.latitude)) / 2)) / (2 * Math.PI);
  return { x: at.longitude / 360 + 0.5, y };
}

function geoAt({ x, y }: Spot): Geo {
  const latitude = (2 * Math.atan(Math.exp((0.5 - y) * 2 * Math.PI)) - Math.PI / 2) * (180 / Math.PI);
  return { latitude, longitude: ((((x - 0.5) * 360 + 180) % 360) + 360) % 360 - 180 };
}

/** A round length of about so many metres, in metres and in words. */
export function rule(metres: number): { step: number; words: string } {
  const far = metres >= (units.system === "imperial" ? 1609.344 : 1000);
  const [unit, per] = far ? (["km", 1000] as const) : (["m", 1] as const);
  const length = round(units.shown(metres / per, unit));
  return { step: units.meant(length, unit) * per, words: `${length} ${units.name(unit)}` };
}

/** What of the Earth is seen in a box of pixels, north up, by the projection of web maps. */
export class Plane {
  centre: Geo = { latitude: 0, longitude: 0 };
  zoomed = 2;
  size = { width: 0, height: 0 };

  get #side(): number {
    return TILE * 2 ** this.zoomed;
  }

  /** Pixels in a metre at the middle. */
  get scale(): number {
    return this.#side / (EQUATOR * Math.cos(rad(kept(this.centre.latitude))));
  }

  /** Begin at a place, close to it. */
  begin(at: Geo): void {
    this.centre = { latitude: kept(at.latitude), longitude: at.longitude };
    this.zoomed = this.#zoomOf(BEGIN);
  }

  #zoomOf(scale: number): number {
    return Math.log2((scale * EQUATOR * Math.cos(rad(this.centre.latitude))) / TILE);
  }

  toScreen(at: Geo): [number, number] {
    const [spot, middle] = [spotOf(at), spotOf(this.centre)];
    const x = spot.x - middle.x;
    const near = x - Math.round(x); // the shorter way round
    return [this.size.width / 2 + near * this.#side, this.size.height / 2 + (spot.y - middle.y) * this.#side];
  }

  at(px: number, py: number): Geo {
    const middle = spotOf(this.centre);
    return geoAt({ x: middle.x + (px - this.size.width / 2) / this.#side, y: middle.y + (py - this.size.height / 2) / this.#side });
  }

  move(px: number, py: number): void {
    this.#look(this.at(this.size.width / 2 - px, this.size.height / 2 - py));
  }

  /** Show a place in the middle, as far as nothing beyond the poles comes into sight. */
  #look(at: Geo): void {
    const half = this.size.height / 2 / this.#side;
    const spot = spotOf(at);
    const y = half > 0.5 ? 0.5 : Math.min(1 - half, Math.max(half, spot.y));
    this.centre = geoAt({ x: spot.x, y });
  }

  /** Come closer, or go farther, with what is at a pixel staying there. */
  zoom(by: number, px = this.size.width / 2, py = this.size.height / 2): void {
    const before = spotOf(this.at(px, py));
    this.zoomed = this.#bounded(this.zoomed + Math.log2(by));
    const after = spotOf(this.at(px, py));
    const middle = spotOf(this.centre);
    this.#look(geoAt({ x: middle.x + before.x - after.x, y: middle.y + before.y - after.y }));
  }

  #bounded(zoom: number): number {
    return Math.min(MOST, Math.max(Math.log2(Math.max(this.size.height, TILE) / TILE), zoom));
  }

  fit(places: Geo[]): void {
    const [first] = places;
    if (!first) return;
    const start = spotOf(first);
    const spots = places.map((one) => spotOf(one)).map(({ x, y }) => ({ x: x - Math.round(x - start.x), y }));
    const [xs, ys] = [spots.map((one) => one.x), spots.map((one) => one.y)];
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    this.centre = geoAt({ x: (x0 + x1) / 2, y: (y0 + y1) / 2 });
    const side = Math.min((0.7 * this.size.width) / Math.max(x1 - x0, 1e-12), (0.7 * this.size.height) / Math.max(y1 - y0, 1e-12));
    this.zoomed = this.#bounded(Math.min(this.#zoomOf(NEAREST), Math.log2(side / TILE)));
    this.#look(this.centre);
  }

  /** Draw lines of longitude and latitude. */
  grid(pen: CanvasRenderingContext2D, colour: (name: string) => string): void {
    const { width, height } = this.size;
    const low = this.at(0, height);
    const high = this.at(width, 0);
    const across = width / this.#side >= 1 ? 360 : (high.longitude - low.longitude + 360) % 360;
    const step = round((110 * across) / width);
    const digits = Math.min(7, Math.max(0, Math.ceil(-Math.log10(step))));
    pen.strokeStyle = colour("--line");
    pen.fillStyle = colour("--dim");
    pen.lineWidth = 1;
    pen.font = "12px system-ui, sans-serif";
    pen.beginPath();
    for (let longitude = Math.ceil(low.longitude / step) * step; longitude <= low.longitude + across; longitude += step) {
      const [px] = this.toScreen({ latitude: this.centre.latitude, longitude });
      pen.moveTo(px, 0);
      pen.lineTo(px, height);
      pen.fillText(rounded(longitude, digits), px + 4, height - 6);
    }
    for (let latitude = Math.ceil(low.latitude / step) * step; latitude <= high.latitude; latitude += step) {
      const [, py] = this.toScreen({ latitude, longitude: this.centre.longitude });
      pen.moveTo(0, py);
      pen.lineTo(width, py);
      pen.fillText(rounded(latitude, digits), 6, py + 14);
    }
    pen.stroke();
  }

  /** Draw how long a metre is and where north is. */
  ruler(pen: CanvasRenderingContext2D, colour: (name: string) => string): void {
    const { width, height } = this.size;
    const { step, words } = rule(110 / this.scale);
    const [left, right] = [width - 20 - step * this.scale, width - 20];
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = colour("--panel");
    pen.globalAlpha = 0.75;
    pen.fillRect(left - 6, height - 56, right - left + 12, 28);
    pen.fillRect(width - 48, 10, 36, 22);
    pen.globalAlpha = 1;
    pen.fillStyle = colour("--text");
    pen.fillRect(left, height - 34, right - left, 3);
    pen.textAlign = "right";
    pen.fillText(words, right, height - 40);
    pen.fillText("N ↑", right, 24);
    pen.textAlign = "left";
  }
}
