import { THREE } from "nicegui-scene";

// A line with at most maxPoints points; a new one then replaces the oldest.
export default class TcpTrace {
  create_mesh(maxPoints) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * maxPoints), 3));
    geometry.setDrawRange(0, 0);
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ transparent: true }));
    line.frustumCulled = false;
    return line;
  }
}
