import { BoxGeometry, LoadingManager, Mesh, MeshPhongMaterial, type Material, type Object3D, TextureLoader } from "three";
import { ColladaLoader } from "three/addons/loaders/ColladaLoader.js";
import { STLLoader } from "three/addons/loaders/STLLoader.js";

import { say } from "../language.svelte.ts";

/** Gets a file that a description names, from the robot's own machine. */
export type Fetch = (uri: string) => Promise<Uint8Array<ArrayBuffer>>;

const AT_ONCE = 4;
const MOST_FILES = 256; // that are kept, and problems: markers may name others without end
const NOTHING = "data:image/gif;base64,R0lGODlhAQABAAAAACw="; // where a texture could not be had

/** The meshes of one description. Each file is got once, however often it is drawn. */
export class Meshes {
  /** What could not be had, and why. */
  readonly problems = new Map<string, string>();
  readonly manager = new LoadingManager();
  readonly #fetch: Fetch | undefined;
  readonly #files = new Map<string, Promise<Uint8Array<ArrayBuffer>>>();
  readonly #pictures = new Map<string, string>();
  readonly #waiting: (() => void)[] = [];
  #busy = 0;
  #over = false;

  constructor(fetch: Fetch | undefined) {
    this.#fetch = fetch;
    this.manager.setURLModifier((url) => (url.startsWith("data:") || url.startsWith("blob:") ? url : (this.#pictures.get(plain(url)) ?? NOTHING)));
  }

  /** Make an object of a file; a box stands for what cannot be had. */
  async load(uri: string, material: Material): Promise<Object3D> {
    try {
      const made = await this.#made(uri, material);
      this.problems.delete(uri);
      return made;
    } catch (error) {
      if (this.problems.size >= MOST_FILES) this.problems.clear();
      this.problems.set(uri, (error as Error).message);
      return new Mesh(new BoxGeometry(0.1, 0.1, 0.1), new MeshPhongMaterial({ color: 0xd08080, wireframe: true }));
    }
  }

  async #made(uri: string, material: Material): Promise<Object3D> {
    const ending = uri.slice(uri.lastIndexOf(".") + 1).toLowerCase();
    if (ending === "gltf") throw new Error(say(".gltf is not supported: convert it to a single .glb"));
    if (!["stl", "dae", "obj", "glb"].includes(ending)) throw new Error(`.${ending} is not supported`);
    const data = await this.#file(uri);
    if (ending === "stl") return new Mesh(new STLLoader().parse(data.slice().buffer), material);
    if (ending === "glb") return this.#glb(data);
    const text = new TextDecoder().decode(data);
    return ending === "dae" ? this.#dae(uri, text) : this.#obj(uri, text, material);
  }

  async #dae(uri: string, text: string): Promise<Object3D> {
    await this.pictures([...text.matchAll(/<image\b[^>]*>[^]*?<init_from>\s*([^<]+?)\s*<\/init_from>/g)].map((found) => join(uri, found[1] as string)));
    // RViz takes the vertices as they are, whichever axis is said to be up.
    const made = new ColladaLoader(this.manager).parse(text.replace(/<up_axis>[^<]*<\/up_axis>/, ""), folder(uri));
    if (!made) throw new Error("it is not a COLLADA file");
    return made.scene;
  }

  async #obj(uri: string, text: string, material: Material): Promise<Object3D> {
    const { OBJLoader } = await import("three/addons/loaders/OBJLoader.js");
    const loader = new OBJLoader(this.manager);
    const library = /^mtllib\s+(.+?)\s*$/m.exec(text)?.[1];
    const materials = library && (await this.#mtl(join(uri, library)));
    if (materials) loader.setMaterials(materials);
    const made = loader.parse(text);
    if (!materials)
      made.traverse((one: any) => {
        if (one.isMesh) one.material = material;
      });
    return made;
  }

  async #mtl(uri: string): Promise<any> {
    try {
      const { MTLLoader } = await import("three/addons/loaders/MTLLoader.js");
      const text = new TextDecoder().decode(await this.#file(uri));
      await this.pictures([...text.matchAll(/^\s*map_\w+\s+(?:-\S+\s+\S+\s+)*(.+?)\s*$/gm)].map((found) => join(uri, found[1] as string)));
      return new MTLLoader(this.manager).parse(text, folder(uri));
    } catch (error) {
      this.problems.set(uri, (error as Error).message);
      return undefined;
    }
  }

  async #glb(data: Uint8Array<ArrayBuffer>): Promise<Object3D> {
    const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
    const loader = new GLTFLoader(this.manager);
    loader.register((parser: any) => {
      parser.textureLoader = new TextureLoader(this.manager); // the other one fetches, which the page may not
      return { name: "pictures" };
    });
    return (await loader.parseAsync(data.slice().buffer, "")).scene;
  }

  /** Have pictures at hand, for loaders that ask for them by their address. */
  async pictures(uris: string[]): Promise<void> {
    await Promise.all(
      [...new Set(uris.map(plain))].map(async (uri) => {
        if (this.#pictures.has(uri)) return;
        this.#pictures.set(uri, NOTHING);
        try {
          const picture = new Blob([await this.#file(uri)]);
          if (!this.#over) this.#pictures.set(uri, URL.createObjectURL(picture));
        } catch (error) {
          this.problems.set(uri, (error as Error).message);
        }
      }),
    );
  }

  #file(uri: string): Promise<Uint8Array<ArrayBuffer>> {
    let file = this.#files.get(uri);
    if (!file) {
      if (this.#files.size >= MOST_FILES) this.#files.clear();
      this.#files.set(uri, (file = this.#got(uri)));
      file.catch(() => this.#files.delete(uri)); // it may be there when it is asked for again
    }
    return file;
  }

  async #got(uri: string): Promise<Uint8Array<ArrayBuffer>> {
    if (!this.#fetch) throw new Error("no service/assets/fetch, or your role may not call it");
    if (this.#busy >= AT_ONCE) await new Promise<void>((resolve) => this.#waiting.push(resolve));
    this.#busy += 1;
    try {
      if (this.#over) throw new Error("it is no longer shown");
      return await this.#fetch(uri);
    } finally {
      this.#busy -= 1;
      this.#waiting.shift()?.();
    }
  }

  dispose(): void {
    this.#over = true;
    for (const url of this.#pictures.values()) if (url !== NOTHING) URL.revokeObjectURL(url);
  }
}

const folder = (uri: string): string => uri.slice(0, uri.lastIndexOf("/") + 1);

/** A file that another one names, beside it or by an address of its own. */
function join(uri: string, name: string): string {
  return /^\w+:/.test(name) ? plain(name) : plain(folder(uri) + name);
}

/** An address without `.`, `..` and what is written in percents. */
function plain(uri: string): string {
  const [, scheme = "", rest = uri] = /^(\w+:\/\/)(.*)$/.exec(uri) ?? [];
  const parts: string[] = [];
  for (const part of rest.replaceAll("\\", "/").split("/")) {
    if (part === "..") parts.pop();
    else if (part !== "." && part !== "") parts.push(part);
  }
  const text = parts.join("/");
  try {
    return scheme + decodeURIComponent(text);
  } catch {
    return scheme + text;
  }
}
