"use strict";
// The surroundings of an arm: objects that can be dragged, and a ball at the tool that is dragged to push it.
(() => {
  const N_PER_M = 120; // guess: dragging by the width of a hand gives 12 N
  const MAX_N = 150; // guess
  const HEAD_M = 0.06;

  class Surroundings extends pendant.Dragging {
    constructor(THREE, view) {
      super(THREE, view);
      this.objects = new Map(); // name -> mesh
      this.group = new THREE.Group();
      this.ball = new THREE.Mesh(
        new THREE.SphereGeometry(0.032, 24, 16),
        new THREE.MeshPhongMaterial({ color: "#e0662f", transparent: true, opacity: 0.75, depthTest: false }),
      );
      this.ball.renderOrder = 2;
      const red = new THREE.MeshBasicMaterial({ color: "#c62828", depthTest: false, transparent: true, opacity: 0.9 });
      this.shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.008, 0.008, 1, 12), red);
      this.head = new THREE.Mesh(new THREE.ConeGeometry(0.024, HEAD_M, 20), red);
      this.shaft.renderOrder = this.head.renderOrder = 3;
      this.arrow = new THREE.Group();
      this.arrow.add(this.shaft, this.head);
      this.arrow.visible = false;
      this.group.add(this.ball, this.arrow);
      view.scene.add(this.group);
    }

    show({ tool, force, objects }) {
      this.ball.position.set(...tool);
      if (this.drag?.kind !== "push") this.showForce(force);
      const names = new Set(objects.map((object) => object.name));
      for (const [name, mesh] of this.objects) if (!names.has(name)) this.remove(name, mesh);
      for (const object of objects) this.showObject(object);
    }

    showForce(force) {
      const along = new this.THREE.Vector3(...force);
      const size = along.length();
      this.arrow.visible = size > 0.05;
      if (!this.arrow.visible) return;
      const length = size / N_PER_M;
      const shaft = Math.max(0.001, length - HEAD_M);
      this.arrow.position.copy(this.ball.position);
      this.arrow.quaternion.setFromUnitVectors(new this.THREE.Vector3(0, 1, 0), along.normalize());
      this.shaft.scale.y = shaft;
      this.shaft.position.y = shaft / 2;
      this.head.position.y = length - HEAD_M / 2;
    }

    showObject(object) {
      const shape = JSON.stringify([object.box, object.sphere]);
      let mesh = this.objects.get(object.name);
      if (mesh && mesh.userData.shape !== shape) this.remove(object.name, mesh), (mesh = null);
      if (!mesh) {
        mesh = shapes.createObject(this.THREE, object);
        mesh.userData = { shape, name: object.name };
        this.objects.set(object.name, mesh);
        this.group.add(mesh);
      }
      if (this.drag?.mesh === mesh) return;
      shapes.setPose(this.THREE, mesh, object.pose);
    }

    remove(name, mesh) {
      this.objects.delete(name);
      mesh.removeFromParent();
      mesh.geometry.dispose();
    }

    // dragging

    hitTest(caster) {
      return caster.intersectObject(this.ball)[0] || caster.intersectObjects([...this.objects.values()], false)[0];
    }

    grab({ object, point }, viewDirection, vertical) {
      if (object === this.ball) return { kind: "push", normal: viewDirection, origin: object.position.clone() };
      const normal = vertical ? viewDirection.setZ(0).normalize() : new this.THREE.Vector3(0, 0, 1);
      return { kind: "move", mesh: object, from: object.position.clone(), vertical, normal, origin: point };
    }

    dragTo(at) {
      if (this.drag.kind === "push") this.push(at);
      else this.moveObject(at.sub(this.drag.start));
    }

    push(at) {
      const force = at.sub(this.ball.position).multiplyScalar(N_PER_M).clampLength(0, MAX_N);
      this.drag.force = force.toArray().map((value) => Math.round(value * 10) / 10);
      this.showForce(this.drag.force);
      this.send({ push: this.drag.force });
    }

    moveObject(offset) {
      const { mesh, from, vertical } = this.drag;
      mesh.position.copy(from);
      if (vertical) mesh.position.z += offset.z;
      else mesh.position.add(offset.setZ(0));
      this.drag.moved = { move_object: { name: mesh.userData.name, position: mesh.position.toArray() } };
      this.send(this.drag.moved);
    }

    drop(drag) {
      if (drag.kind === "push") {
        if (drag.force) this.send({ push: drag.force }, true); // the last one may not have been sent
        this.send({ push: null }, true);
      } else if (drag.moved) this.send(drag.moved, true);
    }

    // Returns the position of an object, or of the ball without a name, in pixels of the page.
    pixelPosition(name) {
      const mesh = name === undefined ? this.ball : this.objects.get(name);
      if (!mesh) return null;
      return pendant.toPixels(this.view, mesh.getWorldPosition(new this.THREE.Vector3()));
    }
  }

  const surroundings = new Map();
  let THREE = null;

  pendant.surroundings = async (id, scene) => {
    pendant.followers.set(id, (value) => {
      const view = getElement(scene);
      if (!THREE || !view || !view.controls) return false;
      if (!surroundings.has(id) || surroundings.get(id).view !== view) surroundings.set(id, new Surroundings(THREE, view));
      if (value) surroundings.get(id).show(value);
      return true;
    });
    pendant.pixelPosition = (name) => surroundings.get(id)?.pixelPosition(name) ?? null;
    THREE = (await import("nicegui-scene")).THREE;
  };
})();
