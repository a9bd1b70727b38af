import type { Notice, RcpError, Subscription, SubscribeOptions, Update } from "rcp-client";

import { app } from "./app.svelte.ts";

type Told = (update: Update) => void;

interface Feed {
  subscription: Subscription;
  listeners: Set<Told>;
  last: Update | undefined;
}

const feeds = new Map<string, Feed>();

/**
 * Call back with each sample of a path until the returned function is called.
 *
 * Those who want the same share one subscription; a late one gets the last sample at once.
 */
export function watch(
  path: string,
  options: SubscribeOptions,
  told: Told,
  on: { notice?: (notice: Notice) => void; ended?: (error: RcpError | undefined) => void } = {},
): () => void {
  const shared = options.history === undefined && !on.notice && !on.ended;
  const key = shared ? `${app.epoch} ${path} ${JSON.stringify(options)}` : Symbol().toString() + Math.random();
  let feed = feeds.get(key);
  if (feed?.subscription.ended) feed = undefined;
  if (feed === undefined) {
    const made: Feed = { listeners: new Set(), last: undefined, subscription: undefined as never };
    made.subscription = app.client.subscribe(path, options, {
      update: (update) => {
        made.last = update;
        for (const listener of made.listeners) listener(update);
      },
      ...on,
    });
    feeds.set(key, (feed = made));
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
