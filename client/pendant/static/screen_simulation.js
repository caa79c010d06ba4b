"use strict";
// The surroundings of an arm: objects that can be dragged, and a ball at the tool that is dragged to push it.
(() => {
  const N_PER_M = 120; // guess: dragging by the width of a hand gives 12 N
  const MAX_N = 150; // guess
  const HEAD_M = 0.06;
  const SEND_PERIOD_MS = 60;

  class Surroundings {
    constructor(THREE, view) {
      this.THREE = THREE;
      this.view = view;
      this.objects = new Map(); // name -> mesh
      this.drag = null;
      this.lastSent = 0;
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
      for (const [type, handler] of [["pointerdown", this.startDrag], ["pointermove", this.move], ["pointerup", this.endDrag], ["pointercancel", this.endDrag]])
        view.$el.addEventListener(type, handler.bind(this), true);
      window.addEventListener("blur", () => this.endDrag());
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
        mesh = pendant.createObject(this.THREE, object);
        mesh.userData = { shape, name: object.name };
        this.objects.set(object.name, mesh);
        this.group.add(mesh);
      }
      if (this.drag?.mesh === mesh) return;
      pendant.setPose(mesh, object);
    }

    remove(name, mesh) {
      this.objects.delete(name);
      mesh.removeFromParent();
      mesh.geometry.dispose();
    }

    // dragging

    ray(event) {
      return pendant.createRaycaster(this.THREE, this.view, event);
    }

    startDrag(event) {
      if (event.button > 0 || this.drag) return;
      const caster = this.ray(event);
      const viewDirection = this.view.camera.getWorldDirection(new this.THREE.Vector3());
      const pushed = caster.intersectObject(this.ball)[0];
      const hit = pushed ? null : caster.intersectObjects([...this.objects.values()], false)[0];
      if (!pushed && !hit) return;
      const normal = pushed ? viewDirection : event.shiftKey ? viewDirection.setZ(0).normalize() : new this.THREE.Vector3(0, 0, 1);
      const start = pushed ? this.ball.position.clone() : hit.point;
      this.drag = {
        kind: pushed ? "push" : "move", mesh: hit?.object, start, vertical: event.shiftKey, pointer: event.pointerId,
        from: hit?.object.position.clone(),
        plane: new this.THREE.Plane().setFromNormalAndCoplanarPoint(normal, start),
      };
      this.view.controls.enabled = false;
      this.view.$el.setPointerCapture(event.pointerId);
      event.stopPropagation();
      event.preventDefault();
    }

    move(event) {
      if (!this.drag) {
        const over = this.ray(event).intersectObjects([this.ball, ...this.objects.values()], false).length > 0;
        this.view.$el.style.cursor = over ? "grab" : "";
        return;
      }
      event.stopPropagation();
      const at = this.ray(event).ray.intersectPlane(this.drag.plane, new this.THREE.Vector3());
      if (!at) return;
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

    send(message, now = false) {
      const time = performance.now();
      if (!now && time - this.lastSent < SEND_PERIOD_MS) return;
      this.lastSent = time;
      pendant.send(message);
    }

    endDrag(event) {
      const drag = this.drag;
      if (!drag) return;
      event?.stopPropagation();
      this.drag = null;
      this.view.controls.enabled = true;
      if (this.view.$el.hasPointerCapture?.(drag.pointer)) this.view.$el.releasePointerCapture(drag.pointer);
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
