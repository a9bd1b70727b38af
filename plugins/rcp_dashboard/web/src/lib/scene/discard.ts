import type { Object3D } from "three";

/** Give back what the graphics card holds for a thing and all that hangs from it. */
export function discard(thing: Object3D): void {
  thing.traverse((one: any) => {
    one.geometry?.dispose();
    for (const material of [one.material].flat()) {
      if (!material) continue;
      const uniforms = Object.values((material.uniforms ?? {}) as Record<string, { value: unknown }>).map((uniform) => uniform.value);
      for (const value of [...Object.values(material), ...uniforms]) if ((value as any)?.isTexture) (value as any).dispose();
      material.dispose();
    }
  });
}
