/** Tiles, and what draws them, where the gateway has an archive of them. */
import { BASE } from "../app.svelte.ts";
import type { Base } from "./base.ts";

export interface Told {
  laid: (base: Base) => void;
  attribution: (words: string) => void;
  /** Why there are none to see. */
  problem: (message: string) => void;
}

const blind = (): string => "This browser cannot draw the tiles of the map, which need WebGL 2. Lines of latitude and longitude are shown instead.";

/** Lay tiles into a box; returns what takes them away. */
export function layTiles(box: HTMLElement, dark: boolean, told: Told): () => void {
  let over = false;
  let made: Base | undefined;
  const problem = (why: string): void => told.problem(`The tiles cannot be loaded: ${why}`);
  const lay = async (): Promise<void> => {
    const answer = await fetch(`${BASE}/dashboard/map`);
    if (!answer.ok || !((await answer.json()) as { tiles: boolean }).tiles || over) return;
    const { Base: Tiles } = await import("./base.ts");
    if (over) return;
    try {
      made = new Tiles(box, `${BASE}/dashboard/map/tiles`, dark, { attribution: told.attribution, problem });
    } catch {
      return told.problem(blind());
    }
    told.laid(made);
  };
  lay().catch((error: Error) => problem(error.message));
  return () => {
    over = true;
    made?.dispose();
  };
}
