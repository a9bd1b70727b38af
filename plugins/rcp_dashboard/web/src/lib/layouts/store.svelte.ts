import { type RcpError } from "rcp-client";

import { app } from "../app.svelte.ts";
import { watch } from "../watch.ts";
import type { Place } from "./links.ts";

const OWN = "/system/layouts";
const SHARED = "/system/shared_layouts";

/** A layout as the gateway lists it; of a tenant that shares it, or the user's own. */
export interface Entry {
  name: string;
  tenant?: string;
  version: number;
  by: string;
  saved: string;
}

/** The layouts that the gateway keeps, as far as this role may see and change them. */
export class LayoutStore {
  own = $state.raw<Entry[]>([]);
  shared = $state.raw<Entry[]>([]);
  readonly usable = $derived(app.may(OWN, "execute") && app.hello !== undefined && app.hello.principal !== "anonymous");
  readonly may = $derived(app.may(OWN, "subscribe"));
  readonly shares = $derived(app.may(SHARED, "execute"));

  /** Follow the lists, to be called in a component. */
  start(): void {
    $effect(() => (this.may ? watch(OWN, {}, ({ body }) => (this.own = body)) : undefined));
    $effect(() => (app.may(SHARED, "subscribe") ? watch(SHARED, {}, ({ body }) => (this.shared = body)) : undefined));
  }

  entry({ name, tenant }: Place): Entry | undefined {
    return (tenant === undefined ? this.own : this.shared).find((one) => one.name === name && one.tenant === tenant);
  }

  /** Raises `RcpError` where there is none. */
  async open({ name, tenant }: Place): Promise<{ version: number; content: unknown }> {
    return (await app.client.execute(OWN, { do: "open", name, ...(tenant !== undefined && { tenant }) }).result) as { version: number; content: unknown };
  }

  /** Save what was made from a version, 0 for none; returns the new one. Raises `RcpError` where somebody else saved since. */
  async save({ name, tenant }: Place, version: number, content: unknown): Promise<number> {
    const body = { do: "save", name, version, content, ...(tenant !== undefined && { tenant }) };
    return ((await app.client.execute(tenant === undefined ? OWN : SHARED, body).result) as Entry).version;
  }

  async remove({ name, tenant }: Place, version: number): Promise<void> {
    await app.client.execute(tenant === undefined ? OWN : SHARED, { do: "remove", name, version, ...(tenant !== undefined && { tenant }) }).result;
  }
}

/** Whether a save was refused because somebody else saved or removed the layout since. */
export function outdated(error: RcpError | undefined): boolean {
  return error?.code === "precondition_failed";
}
