"use strict";
// Plan tab: obstacles, the handle with which the target is dragged, and the planned path. See screens/move_plan.py.
(() => {
  const ARROW_M = 0.17;
  const RING_M = 0.12;
  const PATH_M = 0.004; // radius of the line that shows the path
  const PATH = "#b0267a";
  const TARGET = "#e07b00";
  const RED = "#d02020";
  const FAR = "#8a949d";
  const AXES = ["#d6453d", "#3d9a4a", "#2f6fd0"];
  const views = new Map(); // element id of a scene -> its view
  const shown = new Map(); // element id of a scene -> the last value of each kind
  let THREE = null;

  class View extends pendant.Dragging {
    constructor(scene) {
      super(THREE, scene);
      this.root = scene.scene;
      this.objects = [];
      this.version = 1;
      this.build();
    }

    // The handle: a ball, and an arrow and a ring per axis. Thicker invisible shapes make them easier to grab.
    build() {
      this.handle = new THREE.Group();
      this.handle.name = "handle";
      this.handle.visible = false;
      this.grabShapes = [];
      this.ball = this.part(new THREE.SphereGeometry(0.028, 24, 16), TARGET, 0.8, { shape: "ball" });
      AXES.forEach((color, axis) => {
        const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), this.unit(axis));
        const along = (geometry) => geometry.rotateX(Math.PI / 2).translate(0, 0, ARROW_M / 2); // from y to z
        const tip = new THREE.ConeGeometry(0.014, 0.04, 16).rotateX(Math.PI / 2).translate(0, 0, ARROW_M);
        this.part(along(new THREE.CylinderGeometry(0.005, 0.005, ARROW_M, 10)), color, 0.9).quaternion.copy(turn);
        this.part(tip, color, 0.9).quaternion.copy(turn);
        this.part(new THREE.TorusGeometry(RING_M, 0.003, 8, 64), color, 0.75).quaternion.copy(turn);
        const arrow = new THREE.CylinderGeometry(0.014, 0.014, ARROW_M * 0.75, 8).translate(0, ARROW_M * 0.25, 0);
        this.part(along(arrow), color, 0, { shape: "arrow", axis }).quaternion.copy(turn);
        this.part(new THREE.TorusGeometry(RING_M, 0.012, 6, 48), color, 0, { shape: "ring", axis }).quaternion.copy(turn);
      });
      this.root.add(this.handle);
    }

    unit(axis) {
      return new THREE.Vector3().setComponent(axis, 1);
    }

    part(geometry, color, opacity, grab) {
      const material = new THREE.MeshBasicMaterial({ color, opacity, transparent: true, depthTest: false });
      const mesh = new THREE.Mesh(geometry, material);
      mesh.renderOrder = 4;
      mesh.visible = opacity > 0;
      if (grab) {
        mesh.userData = grab;
        this.grabShapes.push(mesh);
      }
      this.handle.add(mesh);
      return mesh;
    }

    showObjects(value) {
      for (const mesh of this.objects) mesh.removeFromParent();
      this.objects = [];
      for (const object of value?.objects || []) {
        const color = value.red.includes(object.name) ? RED : undefined;
        // an attached object is shown at the arm and at the ghost, in the frame of the last joint
        for (const name of object.attached ? ["joint 5", "ghost joint 5"] : [null]) {
          const parent = name ? this.root.getObjectByName(name) : this.root;
          if (!parent) return false; // the arm has not been drawn yet
          const mesh = shapes.createObject(THREE, object, color);
          mesh.name = `object ${object.name}`;
          mesh.userData.version = this.version++;
          shapes.setPose(THREE, mesh, object.pose);
          parent.add(mesh);
          this.objects.push(mesh);
        }
      }
      return true;
    }

    hasOrphanedObjects() {
      return this.objects.some((mesh) => {
        let top = mesh;
        while (top.parent) top = top.parent;
        return top !== this.root;
      });
    }

    showGoal(value) {
      this.goal = value;
      this.handle.visible = Boolean(value);
      if (!value) return this.endDrag();
      this.ball.material.color.set(value.far ? FAR : value.red.length ? RED : TARGET);
      const ghost = this.root.getObjectByName("ghost");
      ghost?.traverse((part) => {
        if (!part.isMesh || part.name.startsWith("object ")) return;
        let link = part;
        while (link !== ghost && !link.name.startsWith("ghost joint ")) link = link.parent;
        const number = link === ghost ? 0 : 1 + Number(link.name.slice(12));
        part.material.color.set(value.red.includes(number) ? RED : TARGET);
      });
      if (this.drag) return;
      this.handle.position.set(...value.position);
      this.turn.set(...value.quaternion);
      this.orient();
    }

    turn = new THREE.Quaternion(); // of the target

    orient() {
      if (this.goal.turned) this.handle.quaternion.copy(this.turn);
      else this.handle.quaternion.identity();
    }

    showPath(id, value) {
      this.path?.removeFromParent();
      this.path = null;
      pendant.play(id, value);
      if (!value) return;
      const points = value.points.map((point) => new THREE.Vector3(...point));
      const distinct = points.filter((point, i) => i === 0 || point.distanceTo(points[i - 1]) > 1e-4);
      if (distinct.length < 2) return; // the TCP does not move: the path only rotates the tool
      const curve = new THREE.CatmullRomCurve3(distinct, false, "centripetal");
      const geometry = new THREE.TubeGeometry(curve, 2 * distinct.length, PATH_M, 6);
      this.path = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: PATH }));
      this.path.name = "path";
      this.path.userData.version = this.version++;
      this.root.add(this.path);
    }

    // dragging

    hitTest(caster) {
      return this.handle.visible ? caster.intersectObjects(this.grabShapes, false)[0] : null;
    }

    grab({ object }, viewDirection) {
      const { shape, axis } = object.userData;
      const along = axis === undefined ? null : this.unit(axis).applyQuaternion(this.handle.quaternion);
      const normal = shape === "ball" ? viewDirection : shape === "ring" ? along : along.clone().cross(viewDirection).cross(along).normalize();
      const origin = this.handle.position.clone();
      return { shape, along, normal, origin, turn: this.turn.clone(), axes: this.handle.quaternion.clone() };
    }

    dragTo(at) {
      const { shape, along, origin, start, turn, axes } = this.drag;
      if (shape === "ring") {
        const from = start.clone().sub(origin);
        const to = at.clone().sub(origin);
        const angle = Math.atan2(from.clone().cross(to).dot(along), from.dot(to));
        const by = new THREE.Quaternion().setFromAxisAngle(along, angle);
        this.turn.copy(by).multiply(turn);
        if (this.goal.turned) this.handle.quaternion.copy(by).multiply(axes);
      } else {
        const offset = at.sub(start);
        this.handle.position.copy(origin).add(shape === "arrow" ? along.clone().multiplyScalar(offset.dot(along)) : offset);
      }
      this.sendGoal(false);
    }

    drop() {
      this.sendGoal(true);
    }

    sendGoal(end) {
      this.send({ goal: { position: this.handle.position.toArray(), quaternion: this.turn.toArray(), end } }, end);
    }
  }

  const kinds = {
    objects: (found, value) => found.showObjects(value),
    goal: (found, value) => found.showGoal(value),
    path: (found, value, id) => found.showPath(id, value),
  };

  function view(id) {
    const scene = getElement(id);
    if (!THREE || !scene?.scene || !scene.controls) return null;
    if (views.get(id)?.root !== scene.scene) views.set(id, new View(scene));
    return views.get(id);
  }

  for (const [kind, show] of Object.entries(kinds))
    pendant.receivers[kind] = (value, id) => {
      const found = view(id);
      if (!found || show(found, value, id) === false) return false;
      shown.set(id, { ...shown.get(id), [kind]: value });
      return true;
    };

  // A scene is created again after the browser has lost its graphics context, and an arm when its calibration arrives.
  setInterval(() => {
    for (const [id, values] of shown) {
      const known = views.get(id);
      const found = view(id);
      if (found && (found !== known || found.hasOrphanedObjects()))
        for (const kind of Object.keys(values)) kinds[kind](found, values[kind], id);
    }
  }, 500);

  pendant.plan = async (id) => {
    THREE = (await import("nicegui-scene")).THREE;
    // Returns where a point of the handle, given in its axes [m], is on the page [px]; null without a handle.
    pendant.handle = (...point) => {
      const found = view(id);
      if (!found?.handle.visible) return null;
      found.handle.updateWorldMatrix(true, false);
      return pendant.toPixels(found.view, found.handle.localToWorld(new THREE.Vector3(...point)));
    };
  };
})();
