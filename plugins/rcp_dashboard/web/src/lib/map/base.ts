/** What lies below the map: tiles of an archive that the gateway serves, drawn by MapLibre. */
import { addProtocol, Map as Drawn, setWorkerCount, setWorkerUrl } from "maplibre-gl";
import "maplibre-gl/dist/maplibre-gl.css";
import workerUrl from "maplibre-gl/dist/maplibre-gl-worker.mjs?url";
import { PMTiles, Protocol, TileType } from "pmtiles";

import type { Plane } from "./plane.ts";
import { type Archive, styleOf, wordsOf } from "./style.ts";

const MOST_ZOOM = 24;
const MOST_NAMES = 20;

const protocol = new Protocol();
let ready = false;

/** Let workers come from a file: the policy of the page allows no others. */
function prepare(): void {
  if (ready) return;
  ready = true;
  setWorkerUrl(new URL(workerUrl, document.baseURI).href);
  setWorkerCount(1);
  addProtocol("pmtiles", protocol.tile);
}

export interface Told {
  /** Who made the tiles, once that is known. */
  attribution: (words: string) => void;
  /** Why there are no tiles to see. */
  problem: (message: string) => void;
}

/** The tiles in a box, following a plane. */
export class Base {
  readonly #map: Drawn;
  #archive: Archive | undefined;
  #dark: boolean;
  #over = false;
  /** What was shown last. */
  #place = "";

  /** Draw the archive at a URL; throws where the browser has no WebGL 2. */
  constructor(box: HTMLElement, url: string, dark: boolean, told: Told) {
    prepare();
    this.#dark = dark;
    this.#map = new Drawn({
      container: box,
      style: styleOf(undefined, dark),
      interactive: false,
      attributionControl: false,
      fadeDuration: 0,
      maxZoom: MOST_ZOOM,
      validateStyle: false,
    });
    this.#map.getCanvas().tabIndex = -1; // what is above it takes the keys
    this.#map.on("error", ({ error }) => told.problem(error.message));
    this.#map.on("idle", () => {
      box.dataset["tiles"] = this.#archive ? "drawn" : "none";
      box.dataset["names"] = this.#names();
    });
    this.#open(url, told).catch((error: Error) => told.problem(error.message));
  }

  async #open(url: string, told: Told): Promise<void> {
    const file = new PMTiles(url);
    const [header, about] = [await file.getHeader(), (await file.getMetadata()) as any];
    if (this.#over) return;
    protocol.add(file);
    const vector = header.tileType === TileType.Mvt;
    const layers = vector ? ((about?.vector_layers ?? []) as { id: unknown }[]).map((one) => String(one.id)) : undefined;
    this.#archive = { url, layers };
    told.attribution(wordsOf(about?.attribution));
    this.#draw();
  }

  /** Some of the names that are written now. */
  #names(): string {
    const layers = this.#map.getStyle().layers.filter(({ type }) => type === "symbol").map(({ id }) => id);
    const found = layers.length > 0 ? this.#map.queryRenderedFeatures({ layers }) : [];
    return [...new Set(found.map(({ properties }) => String(properties["name"])))].slice(0, MOST_NAMES).join(", ");
  }

  #draw(): void {
    this.#map.setStyle(styleOf(this.#archive, this.#dark), { diff: false }); // one that is still loading cannot be changed
  }

  /** Show what the plane shows, now and not a picture later. */
  follow(plane: Plane): void {
    const { latitude, longitude } = plane.centre;
    const place = `${latitude} ${longitude} ${plane.zoomed} ${plane.size.width} ${plane.size.height}`;
    if (place === this.#place) return; // robots move, and the tiles lie still
    this.#place = place;
    this.#map.jumpTo({ center: [longitude, latitude], zoom: plane.zoomed });
    this.#map.redraw();
  }

  resize(): void {
    this.#place = "";
    this.#map.resize();
  }

  theme(dark: boolean): void {
    if (dark === this.#dark) return;
    this.#dark = dark;
    this.#draw();
  }

  dispose(): void {
    this.#over = true;
    this.#map.remove();
  }
}
