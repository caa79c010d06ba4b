"use strict";
// The surroundings of an arm: objects that can be dragged, and a ball at the tool that is dragged to push it.
(() => {
  const N_PER_M = 120; // guess: dragging by the width of a hand gives 12 N
  const MOST_N = 150; // guess
  const HEAD_M = 0.06;
  const TELL_MS = 60;

  class Surroundings {
    constructor(THREE, view) {
      this.THREE = THREE;
      this.view = view;
      this.things = new Map(); // name -> mesh
      this.drag = null;
      this.told = 0;
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
      for (const [type, handler] of [["pointerdown", this.down], ["pointermove", this.move], ["pointerup", this.up], ["pointercancel", this.up]])
        view.$el.addEventListener(type, handler.bind(this), true);
      window.addEventListener("blur", () => this.up());
    }

    show({ tool, force, things }) {
      this.ball.position.set(...tool);
      if (this.drag?.what !== "push") this.point(force);
      const names = new Set(things.map((thing) => thing.name));
      for (const [name, mesh] of this.things) if (!names.has(name)) this.remove(name, mesh);
      for (const thing of things) this.put(thing);
    }

    point(force) {
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

    put(thing) {
      const shape = JSON.stringify([thing.box, thing.sphere]);
      let mesh = this.things.get(thing.name);
      if (mesh && mesh.userData.shape !== shape) this.remove(thing.name, mesh), (mesh = null);
      if (!mesh) {
        mesh = pendant.thing(this.THREE, thing);
        mesh.userData = { shape, name: thing.name };
        this.things.set(thing.name, mesh);
        this.group.add(mesh);
      }
      if (this.drag?.mesh === mesh) return;
      pendant.place(mesh, thing);
    }

    remove(name, mesh) {
      this.things.delete(name);
      mesh.removeFromParent();
      mesh.geometry.dispose();
    }

    // dragging

    ray(event) {
      return pendant.ray(this.THREE, this.view, event);
    }

    down(event) {
      if (event.button > 0 || this.drag) return;
      const caster = this.ray(event);
      const away = this.view.camera.getWorldDirection(new this.THREE.Vector3());
      const pushed = caster.intersectObject(this.ball)[0];
      const met = pushed ? null : caster.intersectObjects([...this.things.values()], false)[0];
      if (!pushed && !met) return;
      const normal = pushed ? away : event.shiftKey ? away.setZ(0).normalize() : new this.THREE.Vector3(0, 0, 1);
      const start = pushed ? this.ball.position.clone() : met.point;
      this.drag = {
        what: pushed ? "push" : "move", mesh: met?.object, start, vertical: event.shiftKey, pointer: event.pointerId,
        from: met?.object.position.clone(),
        plane: new this.THREE.Plane().setFromNormalAndCoplanarPoint(normal, start),
      };
      this.view.controls.enabled = false;
      this.view.$el.setPointerCapture(event.pointerId);
      event.stopPropagation();
      event.preventDefault();
    }

    move(event) {
      if (!this.drag) {
        const over = this.ray(event).intersectObjects([this.ball, ...this.things.values()], false).length > 0;
        this.view.$el.style.cursor = over ? "grab" : "";
        return;
      }
      event.stopPropagation();
      const at = this.ray(event).ray.intersectPlane(this.drag.plane, new this.THREE.Vector3());
      if (!at) return;
      if (this.drag.what === "push") this.push(at);
      else this.carry(at.sub(this.drag.start));
    }

    push(at) {
      const force = at.sub(this.ball.position).multiplyScalar(N_PER_M).clampLength(0, MOST_N);
      this.drag.force = force.toArray().map((value) => Math.round(value * 10) / 10);
      this.point(this.drag.force);
      this.tell({ push: this.drag.force });
    }

    carry(way) {
      const { mesh, from, vertical } = this.drag;
      mesh.position.copy(from);
      if (vertical) mesh.position.z += way.z;
      else mesh.position.add(way.setZ(0));
      this.drag.moved = { move_thing: { name: mesh.userData.name, position: mesh.position.toArray() } };
      this.tell(this.drag.moved);
    }

    tell(what, now = false) {
      const time = performance.now();
      if (!now && time - this.told < TELL_MS) return;
      this.told = time;
      pendant.say(what);
    }

    up(event) {
      const drag = this.drag;
      if (!drag) return;
      event?.stopPropagation();
      this.drag = null;
      this.view.controls.enabled = true;
      if (this.view.$el.hasPointerCapture?.(drag.pointer)) this.view.$el.releasePointerCapture(drag.pointer);
      if (drag.what === "push") {
        if (drag.force) this.tell({ push: drag.force }, true); // the last one may not have been sent
        this.tell({ push: null }, true);
      } else if (drag.moved) this.tell(drag.moved, true);
    }

    // Returns the position of an object, or of the ball without a name, in pixels of the page.
    where(name) {
      const mesh = name === undefined ? this.ball : this.things.get(name);
      if (!mesh) return null;
      return pendant.pixels(this.view, mesh.getWorldPosition(new this.THREE.Vector3()));
    }
  }

  const known = new Map();
  let THREE = null;

  pendant.surroundings = async (id, scene) => {
    pendant.followers.set(id, (value) => {
      const view = getElement(scene);
      if (!THREE || !view || !view.controls) return false;
      if (!known.has(id) || known.get(id).view !== view) known.set(id, new Surroundings(THREE, view));
      if (value) known.get(id).show(value);
      return true;
    });
    pendant.where = (name) => known.get(id)?.where(name) ?? null;
    THREE = (await import("nicegui-scene")).THREE;
  };
})();
