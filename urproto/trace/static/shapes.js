"use strict";
// Shapes of the 3D views: the pendant's, and those of the pages of traces.
const shapes = (() => {
  // Creates an object from its description in a world file, in the colour of its kind unless one is given.
  function createObject(THREE, description, color) {
    const [radius, length] = description.cylinder || [];
    const geometry = description.box
      ? new THREE.BoxGeometry(...description.box)
      : description.sphere
        ? new THREE.SphereGeometry(description.sphere, 32, 20)
        : description.cylinder
          ? new THREE.CylinderGeometry(radius, radius, length, 32).rotateX(Math.PI / 2)
          : description.mesh
            ? hull(THREE, description.mesh)
            : new THREE.PlaneGeometry(1.6, 1.6);
    const flat = !description.box && !description.sphere && !description.cylinder && !description.mesh;
    const material = new THREE.MeshPhongMaterial({
      color: color || (flat ? "#8f9ba6" : "#c99a5b"), transparent: true, opacity: flat ? 0.45 : 0.9, side: THREE.DoubleSide,
    });
    const mesh = new THREE.Mesh(geometry, material);
    if (!description.sphere)
      mesh.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry), new THREE.LineBasicMaterial({ color: "#6b4d22" })));
    return mesh;
  }

  function hull(THREE, { points, triangles }) {
    const corners = triangles.flatMap((triangle) => triangle.flatMap((corner) => points[corner]));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(corners, 3));
    geometry.computeVertexNormals();
    return geometry;
  }

  // x, y, z [m], and a rotation vector [rad]
  function setPose(THREE, mesh, [x, y, z, ...rotation]) {
    const axis = new THREE.Vector3(...rotation);
    const angle = axis.length();
    mesh.position.set(x, y, z);
    mesh.quaternion.setFromAxisAngle(angle ? axis.divideScalar(angle) : axis, angle);
  }

  return { createObject, setPose };
})();
