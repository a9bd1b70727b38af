import { BoxGeometry, LoadingManager, Mesh, MeshStandardMaterial, type Object3D } from "three";
import URDFLoader, { type URDFRobot } from "urdf-loader";

/**
 * Build a robot from its description.
 *
 * Meshes stand in files of the robot's own machine, which no page can reach: a small box stands for each.
 */
export function modelOf(text: string): URDFRobot {
  const loader = new URDFLoader(new LoadingManager());
  loader.loadMeshCb = (_path, _manager, _material, done: (made: Object3D) => void) =>
    done(new Mesh(new BoxGeometry(0.05, 0.05, 0.05), new MeshStandardMaterial({ color: 0x9aa7b5 })));
  return loader.parse(text);
}
