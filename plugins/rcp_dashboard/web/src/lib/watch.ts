import type { Notice, RcpError, Subscription, SubscribeOptions, Update } from "rcp-client";

import { untrack } from "svelte";

import { app } from "./app.svelte.ts";
import { past } from "./past.svelte.ts";
import { playback } from "./rewind.svelte.ts";

const AGAIN = 3000; // ms: what is not there, or was taken away, may come back

type Told = (update: Update) => void;

interface Feed {
  subscription: Subscription;
  listeners: Set<Told>;
  last: Update | undefined;
}

const feeds = new Map<string, Feed>();

interface On {
  notice?: (notice: Notice) => void;
  ended?: (error: RcpError | undefined) => void;
}

function begin(path: string, options: SubscribeOptions, on: On): Feed {
  const made: Feed = { listeners: new Set(), last: undefined, subscription: undefined as never };
  const client = app.client;
  const subscribe = (): void => {
    made.subscription = client.subscribe(path, options, {
      update: (update) => {
        made.last = update;
        for (const listener of made.listeners) listener(update);
      },
      ...(on.notice && { notice: on.notice }),
      ended: (error) => {
        on.ended?.(error);
        again();
      },
    });
  };
  const again = (): unknown =>
    setTimeout(() => {
      if (made.listeners.size === 0 || client !== app.client) return;
      if (path.includes("*") || app.byPath.has(path)) subscribe();
      else again();
    }, AGAIN);
  subscribe();
  return made;
}

/**
 * Call back with each sample of a path until the returned function is called.
 *
 * Where the page looks at the past, those are samples of then; what the gateway tells of itself is always that of the present.
 * Those who want the same share one subscription; a late one gets the last sample at once. One that has ended is tried again.
 */
export function watch(
  path: string,
  options: SubscribeOptions,
  told: Told,
  on: On = {},
): () => void {
  if (path.startsWith("/tenant/") && untrack(() => past.shown)) return playback.follow(matching(path), options.history !== undefined, told);
  const shared = options.history === undefined && !on.notice && !on.ended;
  const key = shared ? `${app.epoch} ${path} ${JSON.stringify(options)}` : Symbol().toString() + Math.random();
  let feed = feeds.get(key);
  if (feed?.subscription.ended) feed = undefined;
  if (feed === undefined) {
    feeds.set(key, (feed = begin(path, options, on)));
  } else if (feed.last) told(feed.last);
  const mine = feed;
  mine.listeners.add(told);
  return () => {
    mine.listeners.delete(told);
    if (mine.listeners.size > 0) return;
    if (feeds.get(key) === mine) feeds.delete(key);
    void mine.subscription.close();
  };
}

/** The resources that a pattern names: a segment by `*`, any number of them by `**`. */
function matching(pattern: string): string[] {
  if (!pattern.includes("*")) return [pattern];
  const text = pattern.replaceAll(/[.+?^${}()|[\]\\]/g, "\\$&").replaceAll("**", "\0").replaceAll("*", "[^/]+").replaceAll("\0", ".*");
  const wanted = new RegExp(`^${text}$`);
  return untrack(() => app.resources).filter((one) => wanted.test(one.path) && one.operations.includes("subscribe")).map((one) => one.path);
}
