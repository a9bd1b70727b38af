import { Matrix4, type Material, type Object3D } from "three";
import URDFLoader, { type URDFJoint, type URDFRobot } from "urdf-loader";

import type { Model } from "./body.ts";
import type { Frames } from "./frames.ts";
import { type Fetch, Meshes } from "./meshes.ts";

/** Build a robot from its description; meshes come later, each with a call of `changed`. */
export async function modelOf(text: string, fetch: Fetch | undefined, changed: () => void): Promise<Model> {
  const robot = joined(text);
  const meshes = new Meshes(fetch);
  meshes.manager.onLoad = changed; // pictures come after what they lie on
  await meshes.pictures([...robot.querySelectorAll("material > texture")].flatMap((one) => one.getAttribute("filename") ?? []));
  const loader = new URDFLoader(meshes.manager);
  loader.packages = (name: string) => `package://${name}`;
  loader.loadMeshCb = (uri: string, _manager: unknown, material: Material, done: (made: Object3D) => void) =>
    void meshes.load(uri, material).then((made) => {
      done(made);
      changed();
    });
  return new Described(loader.parse(robot), meshes);
}

/** Hang all links that hang from none from the first of them: so each has a place of its own. */
function joined(text: string): Element {
  const read = new DOMParser().parseFromString(text, "text/xml");
  const robot = read.querySelector("robot");
  if (!robot || read.querySelector("parsererror")) throw new Error("it is not a robot description in XML");
  const below = new Set([...robot.querySelectorAll("joint > child")].map((one) => one.getAttribute("link")));
  const [first, ...more] = [...robot.querySelectorAll(":scope > link")].map((one) => one.getAttribute("name")).filter((name) => !below.has(name));
  if (!first) throw new Error("it has no link");
  for (const link of more) {
    const joint = read.createElement("joint");
    joint.setAttribute("name", `${first} to ${link}`);
    joint.setAttribute("type", "floating");
    for (const [tag, name] of [["parent", first], ["child", link!]] as const) {
      const end = read.createElement(tag);
      end.setAttribute("link", name);
      joint.append(end);
    }
    robot.append(joint);
  }
  return robot;
}

class Described implements Model {
  readonly object: URDFRobot;
  readonly root: string;
  readonly #meshes: Meshes;
  #told = new Set<string>();

  constructor(robot: URDFRobot, meshes: Meshes) {
    this.object = robot;
    this.#meshes = meshes;
    this.root = Object.keys(robot.links).find((name) => (robot.links[name] as Object3D) === robot) ?? "base_link";
    for (const joint of Object.values(robot.joints)) joint.ignoreLimits = true; // they are where they are told to be
  }

  get problems(): [string, string][] {
    return [...this.#meshes.problems];
  }

  dispose(): void {
    this.#meshes.dispose();
  }

  get links(): string[] {
    return Object.keys(this.object.links);
  }

  link(name: string): Matrix4 | undefined {
    let at: Object3D | null = this.object.links[name.replace(/^\//, "")] ?? null;
    if (!at) return undefined;
    const made = new Matrix4();
    for (; at && at !== this.object; at = at.parent) {
      at.updateMatrix();
      made.premultiply(at.matrix);
    }
    return made;
  }

  joints(value: any): void {
    value.name.forEach((name: string, at: number) => {
      const joint = this.object.joints[name];
      const position = value.position[at];
      if (!joint || typeof position !== "number") return;
      this.#tell(joint);
      joint.setJointValue(position);
    });
  }

  #tell(joint: URDFJoint): void {
    if (this.#told.has(joint.name)) return;
    this.#told.add(joint.name);
    for (const one of (joint as any).mimicJoints as URDFJoint[]) this.#tell(one);
  }

  follow(frames: Frames): void {
    if (frames.names.length === 0) return;
    for (const joint of Object.values(this.object.joints)) {
      if (joint.jointType === "fixed" || this.#told.has(joint.name)) continue;
      const [parent, child] = [joint.parent?.name, joint.children[0]?.name];
      const at = parent && child && frames.between(child, parent);
      if (at) at.decompose(joint.position, joint.quaternion, joint.scale);
    }
  }
}
