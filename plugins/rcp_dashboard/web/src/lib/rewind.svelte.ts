import { untrack } from "svelte";

import { app } from "./app.svelte.ts";
import { past } from "./past.svelte.ts";
import { Playback } from "./playback.ts";
import { heavy, recorded, whyNot } from "./recorded.ts";

/** What pages are told of the past, as its moment moves. */
export const playback = new Playback(
  past,
  async (...asked) => {
    try {
      return await recorded(...asked);
    } catch (error) {
      throw new Error(whyNot(error));
    }
  },
  (path) => heavy(app.byPath.get(path)),
);

$effect.root(() => {
  $effect(() => {
    void app.epoch; // what another login was told is not for this one
    if (past.leaps) untrack(() => playback.leap());
  });
  $effect(() => {
    if (past.at !== undefined) untrack(() => playback.tick());
  });
});
