/** How tiles are drawn: by what their layers are called, since archives name them as they like. */
import type { LayerSpecification, StyleSpecification } from "maplibre-gl";

export interface Archive {
  url: string;
  /** The names of the layers of vector tiles; none of pictures. */
  layers: string[] | undefined;
}

const PICTURE = 256; // pixels of the side of a tile that is a picture

interface Colours {
  ground: string;
  land: string;
  green: string;
  bare: string;
  water: string;
  road: string;
  house: string;
  line: string;
  name: string;
  edge: string;
}

const LIGHT: Colours = { ground: "#e7ebef", land: "#f4f3ee", green: "#d5e5c8", bare: "#e2ddd2", water: "#a9cde8", road: "#ffffff", house: "#d3cbc1", line: "#9aa3ad", name: "#3c4652", edge: "#ffffff" };
const DARK: Colours = { ground: "#14171c", land: "#1d2227", green: "#1f3026", bare: "#2b2a27", water: "#163650", road: "#4a5360", house: "#39404a", line: "#5c6672", name: "#c3ccd6", edge: "#14171c" };

type Part = keyof Omit<Colours, "ground" | "name" | "edge">;

const PARTS: [Part, RegExp][] = [
  ["water", /water|ocean|lake|river|stream/],
  ["house", /build/],
  ["road", /road|transport|street|rail|path|aeroway/],
  ["green", /green|forest|wood|park|landcover|land_?use|natural|vegetation/],
  ["land", /earth|land|ground/],
  ["line", /./],
];
const ORDER: Part[] = ["land", "green", "water", "road", "house", "line"];
const BARE = ["runway", "aerodrome", "industrial", "commercial", "residential", "farmland", "sand", "beach", "parking", "pedestrian"];

/** What has names, the most important last: it is the first to get room. Names of areas are left out, since each tile has a part of them. */
const NAMED = [/road|transport|street/, /poi/, /water|peak/, /place|city|town|settlement/];

function partOf(layer: string): Part {
  return PARTS.find(([, name]) => name.test(layer.toLowerCase()))![0];
}

/** The style of an archive's tiles; of nothing but the ground without one. */
export function styleOf(archive: Archive | undefined, dark: boolean): StyleSpecification {
  const colours = dark ? DARK : LIGHT;
  const ground: LayerSpecification = { id: "ground", type: "background", paint: { "background-color": colours.ground } };
  if (!archive) return { version: 8, sources: {}, layers: [ground] };
  const url = `pmtiles://${archive.url}`;
  if (!archive.layers) {
    const shade = dark ? { "raster-brightness-max": 0.7 } : {};
    return {
      version: 8,
      sources: { tiles: { type: "raster", url, tileSize: PICTURE } },
      layers: [ground, { id: "picture", type: "raster", source: "tiles", paint: { "raster-fade-duration": 0, ...shade } }],
    };
  }
  const sorted = archive.layers.map((name) => ({ name, part: partOf(name) })).sort((a, b) => ORDER.indexOf(a.part) - ORDER.indexOf(b.part));
  return { version: 8, sources: { tiles: { type: "vector", url } }, layers: [ground, ...sorted.flatMap(({ name, part }) => drawn(name, part, colours)), ...named(archive.layers, colours)] };
}

/** Names, drawn with the fonts of the browser: the style tells of no others. */
function named(names: string[], colours: Colours): LayerSpecification[] {
  return NAMED.flatMap((of, rank) =>
    names
      .filter((name) => of.test(name.toLowerCase()) && !NAMED.slice(rank + 1).some((other) => other.test(name.toLowerCase())))
      .flatMap((name) => [along(name, colours), at(name, rank, colours)]),
  );
}

const TEXT = ["coalesce", ["get", "name"], ["get", "name_en"], ["get", "name:en"], ""] as unknown as string;
const SANS = ["sans-serif"];

function along(name: string, { name: colour, edge }: Colours): LayerSpecification {
  return {
    id: `${name} names along`,
    type: "symbol",
    source: "tiles",
    "source-layer": name,
    filter: ["==", ["geometry-type"], "LineString"],
    layout: { "symbol-placement": "line", "text-field": TEXT, "text-font": SANS, "text-size": 12 },
    paint: { "text-color": colour, "text-halo-color": edge, "text-halo-width": 1.5 },
  };
}

function at(name: string, rank: number, { name: colour, edge }: Colours): LayerSpecification {
  return {
    id: `${name} names`,
    type: "symbol",
    source: "tiles",
    "source-layer": name,
    filter: ["==", ["geometry-type"], "Point"],
    layout: { "text-field": TEXT, "text-font": SANS, "text-size": rank === NAMED.length - 1 ? 15 : 12, "text-max-width": 8 },
    paint: { "text-color": colour, "text-halo-color": edge, "text-halo-width": 1.5 },
  };
}

function drawn(name: string, part: Part, colours: Colours): LayerSpecification[] {
  const from = { source: "tiles", "source-layer": name } as const;
  const bare = ["in", ["to-string", ["coalesce", ["get", "kind"], ["get", "class"], ""]], ["literal", BARE]];
  const fill = part === "green" ? ["case", bare, colours.bare, colours.green] : colours[part];
  const major = ["in", ["to-string", ["coalesce", ["get", "kind"], ["get", "class"], ""]], ["literal", ["major", "major_road", "highway", "motorway", "trunk", "primary"]]];
  const broad = part === "road" ? ["interpolate", ["exponential", 1.6], ["zoom"], 9, ["case", major, 0.8, 0.3], 18, ["case", major, 14, 7]] : 1;
  const layers: LayerSpecification[] = [];
  // Lines of what is drawn as an area are its edges.
  if (part !== "line") layers.push({ id: `${name} areas`, type: "fill", ...from, filter: ["==", ["geometry-type"], "Polygon"], paint: { "fill-color": fill as string } });
  layers.push({ id: `${name} lines`, type: "line", ...from, filter: ["==", ["geometry-type"], "LineString"], paint: { "line-color": colours[part], "line-width": broad as number } });
  return layers;
}

/** The words of who made the tiles: an archive has them as a piece of a page. */
export function wordsOf(attribution: unknown): string {
  return typeof attribution === "string" ? attribution.replaceAll(/<[^>]*>/g, "").replaceAll(/&(amp|copy|lt|gt);/g, (_, name: string) => ({ amp: "&", copy: "©", lt: "<", gt: ">" })[name]!).slice(0, 200) : "";
}
