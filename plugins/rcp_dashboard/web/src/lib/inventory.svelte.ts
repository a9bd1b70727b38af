import { app } from "./app.svelte.ts";
import { type Robot, scopesOf } from "./robots.ts";
import { watch } from "./watch.ts";

const PATH = "/system/robots";
const PAUSE = 200; // ms without a key, after which words are looked for

/** What the gateway's inventory says of a robot; what it does not know is absent. */
export interface Listed {
  path: string;
  state: string;
  kind?: string;
  vendor?: string;
  model?: string;
  firmware?: string;
  serial?: string;
  mode?: string;
  battery?: { value: any; stale?: boolean };
  control?: Control;
}

/** Who has control, by a lease on a scope or by commanding a path. */
export interface Control {
  principal: string;
  by: string;
  scope?: string;
  path?: string;
}

/** The robots as the gateway lists them, where it does and this role may read it; and those that words find. */
export class Inventory {
  text = $state("");
  #listed = $state.raw<Listed[]>([]);
  readonly #readable = $derived(app.may(PATH, "subscribe"));
  /** Its paths as one text: it changes only when robots come or go. */
  readonly #paths = $derived(JSON.stringify(this.#listed.map((one) => one.path)));
  readonly #scopes = $derived(scopesOf(app.robots, new Set<string>(JSON.parse(this.#paths))));
  /** The scopes that several robots share. */
  readonly #shared = $derived.by(() => {
    const met = new Set<string>();
    const shared = new Set<string>();
    for (const scopes of this.#scopes.values()) for (const one of scopes) (met.has(one) ? shared : met).add(one);
    return shared;
  });
  readonly #byPath = $derived(new Map(this.#listed.map((one) => [one.path, one])));
  /** What words have found at the gateway; undefined where it is not asked. */
  #found = $state.raw<ReadonlySet<string>>();
  readonly words = $derived(this.text.trim().toLowerCase().split(/\s+/).filter(Boolean));
  readonly shown = $derived(this.words.length ? app.robots.filter((one) => this.#matches(one)) : app.robots);

  /** Follow the list, to be called in a component. */
  start(): void {
    $effect(() => {
      if (this.#readable) return watch(PATH, {}, ({ body }) => (this.#listed = body), { ended: () => (this.#listed = []) });
      this.#listed = [];
    });
    $effect(() => {
      const q = this.words.join(" ");
      if (!q || this.#paths === "[]") {
        this.#found = undefined;
        return;
      }
      let current = true;
      const timer = setTimeout(() => {
        app.client.read(PATH, { q }).then(
          ({ value }) => current && (this.#found = new Set((value as Listed[]).map((one) => one.path))),
          () => current && (this.#found = undefined), // names still find
        );
      }, PAUSE);
      return () => {
        current = false;
        clearTimeout(timer);
      };
    });
  }

  /** What is listed of the robot of a card: nothing where others share its path, or it has several. */
  of(robot: Robot): Listed | undefined {
    const [scope, ...more] = this.#scopes.get(robot.name) ?? [];
    if (scope === undefined || more.length) return undefined;
    return this.#shared.has(scope) ? undefined : this.#byPath.get(scope);
  }

  #matches(robot: Robot): boolean {
    const name = `${robot.name} ${robot.tenant}`.toLowerCase();
    if (this.words.every((word) => name.includes(word))) return true;
    return this.#scopes.get(robot.name)?.some((scope) => this.#found?.has(scope)) ?? false;
  }
}
