import type { Matrix4 } from "three";

import { declutter } from "../labels.ts";
import type { Body } from "./body.ts";
import { discard } from "./discard.ts";
import { FrameMark, Name, sides } from "./layers.ts";
import type { View } from "./view.ts";
import { NAME_LINE } from "./words.ts";

const ROBOT = 1.25; // how much larger the name of a robot is

/** The frames of all robots with their names, and the names of robots where there are several. */
export class Names {
  /** How many names had no room in the last picture. */
  left = 0;
  readonly #view: View;
  readonly #marks = new Map<string, FrameMark>();
  readonly #robots = new Map<string, Name>();
  #before = new Map<string, number>();

  constructor(view: View) {
    this.#view = view;
  }

  /** Put all where they are, and write the names that have room: frames of one robot often stand in one place. */
  settle(bodies: ReadonlyMap<string, Body>, fixed: string, wanted: { frames: boolean; robots: boolean }): void {
    for (const mark of this.#marks.values()) mark.object.visible = false;
    for (const name of this.#robots.values()) name.object.visible = false;
    this.#forget(bodies);
    const names = new Map<string, Name>();
    const standing = [...bodies].map(([space, body]) => ({ space, at: body.at(fixed) })).filter((one) => one.at);
    if (wanted.robots && standing.length > 1) for (const { space, at } of standing) names.set(`robot ${space}`, this.#robot(space, at!));
    if (wanted.frames) for (const [space, body] of bodies) for (const name of body.frames.names) this.#frame(space, name, body, fixed, names);
    const { camera } = this.#view;
    const wishes = [...names].map(([key, name]) => name.wish(key, camera));
    this.#before = declutter(wishes, sides, [], this.#before);
    for (const [key, name] of names) name.stand(this.#before.get(key));
    this.left = names.size - this.#before.size;
  }

  /** Give back what stands for frames that are no longer told of. */
  #forget(bodies: ReadonlyMap<string, Body>): void {
    const known = new Set([...bodies].flatMap(([space, body]) => body.frames.names.map((name) => `${space}: ${name}`)));
    for (const [key, { object }] of this.#marks) {
      if (known.has(key)) continue;
      this.#view.remove(object);
      discard(object);
      this.#marks.delete(key);
    }
  }

  #robot(space: string, at: Matrix4): Name {
    let found = this.#robots.get(space);
    if (!found) {
      this.#robots.set(space, (found = new Name(space || "robot")));
      this.#view.add(found.object);
    }
    found.object.position.setFromMatrixPosition(at);
    found.fit(NAME_LINE * ROBOT * this.#view.pixel);
    found.object.updateMatrixWorld();
    return found;
  }

  #frame(space: string, name: string, body: Body, fixed: string, names: Map<string, Name>): void {
    const key = `${space}: ${name}`;
    let mark = this.#marks.get(key);
    if (!mark) {
      this.#marks.set(key, (mark = new FrameMark(name)));
      this.#view.add(mark.object);
    }
    const at = body.frames.between(name, fixed);
    mark.object.visible = at !== undefined;
    if (!at) return;
    mark.object.matrix.copy(at);
    mark.object.matrixWorldNeedsUpdate = true;
    mark.name.fit(NAME_LINE * this.#view.pixel);
    mark.object.updateMatrixWorld();
    names.set(key, mark.name);
  }
}
