import {
  AmbientLight, Color, DirectionalLight, GridHelper, MOUSE, type Object3D, OrthographicCamera, PerspectiveCamera, Plane, Raycaster, Scene, TOUCH,
  Vector2, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { discard } from "./discard.ts";

export type Mode = "2d" | "3d";

const PAUSE = 45; // ms between pictures that the processor has to draw
const REACH = 12; // m from the middle to the edge of what is seen at first, from above
const FLAT = 20; // heights of the eye: what is farther away on the floor is seen at less than 3°
const NEAR = 6; // m of the eye from the middle along each axis

/** Whether WebGL is done by the processor: then fewer pixels are drawn, and their edges not smoothed. */
function inSoftware(): boolean {
  const probe = document.createElement("canvas").getContext("webgl2");
  const named = probe?.getExtension("WEBGL_debug_renderer_info");
  const name = named && probe?.getParameter(named.UNMASKED_RENDERER_WEBGL);
  probe?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|basic render/i.test(String(name));
}

/** A window into a world that is x forward, y left, z up, in metres. It draws when something has changed. */
export class View {
  readonly scene = new Scene();
  mode: Mode = "2d";
  /** How the last picture was drawn. */
  drawn: Mode | undefined;
  /** Called right before something is drawn. */
  before: () => void = () => undefined;
  readonly #renderer: WebGLRenderer;
  readonly #flat = new OrthographicCamera(-1, 1, 1, -1, 0.1, 2000);
  readonly #deep = new PerspectiveCamera(50, 1, 0.05, 2000);
  #controls!: OrbitControls;
  #middle = new Vector3();
  #dirty = true;
  #high = 1; // pixels
  #frame = 0;
  readonly #observer: ResizeObserver;
  readonly #box: HTMLElement;
  #grid: GridHelper | undefined;
  #held = false;

  /** Raises what WebGL raises where it is not there. */
  constructor(box: HTMLElement) {
    this.#box = box;
    const slow = inSoftware();
    this.#renderer = new WebGLRenderer({ antialias: !slow, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(slow ? 0.5 : Math.min(devicePixelRatio, 2));
    box.append(this.#renderer.domElement);
    this.scene.add(new AmbientLight(0xffffff, 1.6));
    const sun = new DirectionalLight(0xffffff, 1.8);
    sun.position.set(4, -6, 12);
    this.scene.add(sun);
    for (const camera of [this.#flat, this.#deep]) camera.up.set(0, 0, 1);
    this.#flat.up.set(0, 1, 0);
    this.setMode("2d");
    this.#observer = new ResizeObserver(() => this.#fit());
    this.#observer.observe(box);
    this.#fit();
    let drawnAt = 0;
    const draw = (now: number): void => {
      this.#frame = requestAnimationFrame(draw);
      this.#controls.update();
      if (!this.#dirty || (slow && now - drawnAt < PAUSE)) return;
      drawnAt = now;
      this.#dirty = false;
      this.before();
      this.#renderer.render(this.scene, this.camera);
      this.drawn = this.mode;
    };
    draw(0);
  }

  get camera(): OrthographicCamera | PerspectiveCamera {
    return this.mode === "2d" ? this.#flat : this.#deep;
  }

  get canvas(): HTMLCanvasElement {
    return this.#renderer.domElement;
  }

  /** How high the view is: in metres, or at a distance of one metre. */
  get tall(): number {
    return this.mode === "2d" ? (2 * REACH) / this.#flat.zoom : 2 * Math.tan((this.#deep.fov * Math.PI) / 360);
  }

  /** How high a pixel is, as `tall`. */
  get pixel(): number {
    return this.tall / this.#high;
  }

  changed(): void {
    this.#dirty = true;
  }

  setMode(mode: Mode): void {
    this.#controls?.dispose();
    this.mode = mode;
    const at = this.#middle;
    if (mode === "2d") this.#flat.position.set(at.x, at.y, 500);
    else this.#deep.position.set(at.x - NEAR, at.y - NEAR * 0.8, NEAR);
    const controls = new OrbitControls(this.camera, this.canvas);
    controls.enabled = !this.#held;
    controls.target.copy(at);
    controls.enableRotate = mode === "3d";
    controls.zoomToCursor = true;
    controls.maxPolarAngle = Math.PI / 2;
    if (mode === "2d") {
      controls.mouseButtons = { LEFT: MOUSE.PAN, MIDDLE: MOUSE.DOLLY, RIGHT: MOUSE.PAN };
      controls.touches = { ONE: TOUCH.PAN, TWO: TOUCH.DOLLY_PAN };
    }
    controls.addEventListener("change", () => this.changed());
    this.#controls = controls;
    controls.update();
    this.changed();
  }

  /** Hold the camera still while something else is done with the pointer. */
  hold(still: boolean): void {
    this.#held = still;
    this.#controls.enabled = !still;
  }

  /** Move so that a place is in the middle. */
  look(x: number, y: number, z: number): void {
    const by = new Vector3(x, y, z).sub(this.#controls.target);
    if (by.lengthSq() < 1e-8) return;
    this.camera.position.add(by);
    this.#controls.target.add(by);
    this.#middle.copy(this.#controls.target);
    this.changed();
  }

  /** What is in the middle, on the floor or as high as what was looked at. */
  get middle(): { x: number; y: number } {
    return { x: this.#controls.target.x, y: this.#controls.target.y };
  }

  /** Move by parts of the height of the view, to the right and up, or away where it is seen from the side. */
  pan(right: number, up: number): void {
    const { target } = this.#controls;
    const away = target.clone().sub(this.camera.position).setZ(0);
    const length = this.tall * (this.mode === "2d" ? 1 : target.distanceTo(this.camera.position));
    if (this.mode === "2d") away.set(0, 1, 0);
    else away.normalize();
    const by = away.clone().multiplyScalar(up * length).add(new Vector3(away.y, -away.x, 0).multiplyScalar(right * length));
    this.look(target.x + by.x, target.y + by.y, target.z);
  }

  /** Show what is in the middle so many times as large. */
  zoom(by: number): void {
    if (this.mode === "2d") {
      this.#flat.zoom *= by;
      this.#flat.updateProjectionMatrix();
    } else this.#deep.position.sub(this.#controls.target).divideScalar(by).add(this.#controls.target);
    this.changed();
  }

  colours(ground: string, line: string): void {
    this.scene.background = new Color(ground);
    if (this.#grid) this.scene.remove(this.#grid);
    this.#grid?.dispose();
    this.#grid = new GridHelper(100, 100, new Color(line), new Color(line));
    this.#grid.rotation.x = Math.PI / 2;
    this.#grid.position.z = -0.02;
    this.scene.add(this.#grid);
    this.changed();
  }

  add(thing: Object3D): void {
    this.scene.add(thing);
    this.changed();
  }

  remove(thing: Object3D): void {
    this.scene.remove(thing);
    this.changed();
  }

  /** Where the pointer is on the floor; undefined towards the horizon, where a pixel is many metres. */
  floor(event: PointerEvent): { x: number; y: number } | undefined {
    const box = this.canvas.getBoundingClientRect();
    const at = new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
    const ray = new Raycaster();
    ray.setFromCamera(at, this.camera);
    const hit = ray.ray.intersectPlane(new Plane(new Vector3(0, 0, 1)), new Vector3());
    if (!hit || (this.mode === "3d" && hit.distanceTo(this.camera.position) > FLAT * this.camera.position.z)) return undefined;
    return { x: hit.x, y: hit.y };
  }

  #fit(): void {
    const { clientWidth: width, clientHeight: height } = this.#box;
    if (width === 0 || height === 0) return;
    this.#high = height;
    this.#renderer.setSize(width, height);
    const wide = width / height;
    Object.assign(this.#flat, { left: -REACH * wide, right: REACH * wide, top: REACH, bottom: -REACH });
    this.#deep.aspect = wide;
    this.#flat.updateProjectionMatrix();
    this.#deep.updateProjectionMatrix();
    this.changed();
  }

  dispose(): void {
    cancelAnimationFrame(this.#frame);
    this.#observer.disconnect();
    this.#controls.dispose();
    discard(this.scene);
    this.#renderer.dispose();
    this.#renderer.forceContextLoss();
    this.canvas.remove();
  }
}
