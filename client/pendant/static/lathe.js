import { THREE } from "nicegui-scene";

// A solid of revolution about z, smooth except at its edges. Profile: [radius, z] from bottom to top.
export default class Lathe {
  create_geometry(profile, segments) {
    const points = profile.map(([radius, z]) => new THREE.Vector2(radius, z));
    return new THREE.LatheGeometry(points, segments).rotateX(Math.PI / 2);
  }
}
