import { THREE } from "nicegui-scene";

// A line of at most so many points, the oldest of which goes when a new one comes.
export default class TcpTrace {
  create_mesh(most) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * most), 3));
    geometry.setDrawRange(0, 0);
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ transparent: true }));
    line.frustumCulled = false;
    return line;
  }
}
