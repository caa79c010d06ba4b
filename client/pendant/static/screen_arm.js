"use strict";
// The arm in a NiceGUI scene: see client/pendant/arm_scene.py.
(() => {
  const scenes = new Map(); // element id -> its THREE scene, and the joint angles of the arm and the ghost

  const colors = () =>
    document.body.classList.contains("body--dark")
      ? { background: "#1a2128", ground: "#1f2830", grid: 0.12 }
      : { background: "#e9edf1", ground: "#e4e9ee", grid: 0.2 };

  function paint(scene) {
    const { background, ground, grid } = colors();
    scene.renderer.setClearColor(background); // takes effect when the new colour of the ground is rendered
    for (const child of scene.scene.children) {
      if (child.object_id === "ground") {
        child.material.color.set(ground);
        child.material.specular.set("#000000");
      }
      if (child.type === "GridHelper") child.material.opacity = grid;
    }
  }

  function light(scene) {
    for (const child of [...scene.scene.children]) {
      if (child.isAmbientLight) child.intensity = 1.7;
      if (!child.isDirectionalLight) continue;
      child.intensity = 1.5;
      child.position.set(2, -3, 5);
      const second = child.clone(); // from the other side, so that no side looks flat
      second.intensity = 0.9;
      second.position.set(-4, 3, 2);
      scene.scene.add(second);
    }
  }

  // A number that changes when anything has moved; the sines keep movements from cancelling each other out.
  function fingerprint(scene) {
    let sum = scene.$el.clientWidth + 3 * scene.$el.clientHeight;
    let i = 1;
    const add = (value) => (sum += value * Math.sin(i++));
    const addMatrix = (object) => object.matrix.elements.forEach(add);
    scene.scene.traverse((object) => {
      object.updateMatrix();
      addMatrix(object);
      if (object.visible) add(1);
      if (object.name === "trace") add(object.geometry.attributes.position.version);
      if (object.userData.version) add(object.userData.version);
      if (object.material?.color) add(object.material.color.getHex() + object.material.opacity);
    });
    scene.camera.updateMatrix();
    addMatrix(scene.camera);
    return sum;
  }

  // Adapts the scene to the size of its container; in a narrow one the field of view is wider, so that the arm fits.
  function fit(scene) {
    const { clientWidth, clientHeight } = scene.$el;
    if (!clientWidth || !clientHeight) return;
    const wide = Math.max(1, (0.75 * clientHeight) / clientWidth);
    const half = (scene.cameraParams.fov * Math.PI) / 360;
    scene.camera.fov = (360 / Math.PI) * Math.atan(Math.tan(half) * wide);
    scene.resize();
  }

  // Renders a scene only while it is visible, and only after a change: graphics may be slow, and batteries small.
  function render(id, scene) {
    const draw = scene.renderer.render.bind(scene.renderer);
    let last = null;
    scene.renderer.render = (...options) => {
      if (!scene.$el.offsetParent) return;
      setJoints(id, scene);
      const now = fingerprint(scene);
      if (now === last) return;
      last = now;
      draw(...options);
      if (scene.scene.getObjectByName("joint 5")) scene.$el.parentElement.querySelector(".arm-loading")?.remove();
    };
    new ResizeObserver(() => fit(scene)).observe(scene.$el);
  }

  // NiceGUI creates a scene again after the browser has lost its graphics context.
  function setUp(id) {
    const scene = getElement(id);
    if (!scene || !scene.renderer || !scene.controls) return;
    const known = scenes.get(id);
    if (known.scene === scene.scene) return;
    known.scene = scene.scene;
    light(scene);
    paint(scene);
    render(id, scene);
  }

  // Joints are groups with the names "joint 0" and so on, those of the ghost "ghost joint 0" and so on.
  function setJoints(id, scene) {
    const { angles, path } = scenes.get(id);
    const ghost = playbackConfiguration(path) || scenes.get(id).ghost;
    scene.scene.traverse((object) => {
      if (angles && object.name.startsWith("joint ")) object.rotation.z = angles[object.name.slice(6)];
      if (ghost && object.name.startsWith("ghost joint ")) object.rotation.z = ghost[object.name.slice(12)];
      if (object.name === "ghost") object.visible = Boolean(ghost);
    });
    if (angles) trace(scene.scene);
  }

  // The configuration of a ghost that plays a path; null if the user prefers reduced motion.
  const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
  const PAUSE_S = 1; // pause at the end of the path before it is played again
  function playbackConfiguration(path) {
    if (!path?.angles.length || reducedMotion.matches) return null;
    const fraction = ((performance.now() / 1000 - path.since) % (path.duration + PAUSE_S)) / path.duration;
    return path.angles[Math.min(path.angles.length - 1, Math.floor(fraction * path.angles.length))];
  }

  // Adds a point to the trace of the TCP, if the trace is shown and the TCP has moved.
  function trace(scene) {
    const line = scene.getObjectByName("trace");
    const tcp = scene.getObjectByName("tcp");
    if (!line?.visible || !tcp) return;
    tcp.updateWorldMatrix(true, false);
    const [x, y, z] = tcp.matrixWorld.elements.slice(12);
    const { geometry } = line;
    const points = geometry.attributes.position;
    let count = geometry.drawRange.count;
    const distance = (i) => Math.hypot(points.getX(i) - x, points.getY(i) - y, points.getZ(i) - z);
    if (count && distance(count - 1) < 0.001) return;
    if (count === points.count) {
      points.array.copyWithin(0, 3);
      count -= 1;
    }
    points.setXYZ(count, x, y, z);
    points.needsUpdate = true;
    geometry.setDrawRange(0, count + 1);
  }

  pendant.clearTrace = (id) => {
    const line = getElement(id)?.scene?.getObjectByName("trace");
    line?.geometry.setDrawRange(0, 0);
    if (line) line.geometry.attributes.position.needsUpdate = true;
  };

  pendant.receivers.ghost = (angles, id) => {
    const known = scenes.get(id);
    if (known) known.ghost = angles;
    return Boolean(known);
  };

  pendant.play = (id, path) => {
    scenes.get(id).path = path && { ...path, since: performance.now() / 1000 };
  };

  const SEND_PERIOD_MS = 60; // between messages to the pendant during a drag

  // Drags shapes of a scene in a plane. A subclass has the methods hitTest (of a raycaster: what is at the pointer),
  // grab (the normal of the plane, its origin, and what else to remember), dragTo (a point of the plane) and drop.
  pendant.Dragging = class {
    constructor(THREE, view) {
      this.THREE = THREE;
      this.view = view; // NiceGUI's element
      this.drag = null;
      this.lastSent = 0;
      const listen = (type, handler) => view.$el.addEventListener(type, handler.bind(this), true);
      listen("pointerdown", this.startDrag);
      listen("pointermove", this.move);
      listen("pointerup", this.endDrag);
      listen("pointercancel", this.endDrag);
      window.addEventListener("blur", () => this.endDrag());
    }

    raycaster(event) {
      const box = this.view.renderer.domElement.getBoundingClientRect();
      const at = new this.THREE.Vector2(
        ((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2,
      );
      const caster = new this.THREE.Raycaster();
      caster.setFromCamera(at, this.view.camera);
      return caster;
    }

    startDrag(event) {
      if (event.button > 0 || this.drag) return;
      const caster = this.raycaster(event);
      const hit = this.hitTest(caster);
      if (!hit) return;
      const grabbed = this.grab(hit, this.view.camera.getWorldDirection(new this.THREE.Vector3()), event.shiftKey);
      const plane = new this.THREE.Plane().setFromNormalAndCoplanarPoint(grabbed.normal, grabbed.origin);
      const start = caster.ray.intersectPlane(plane, new this.THREE.Vector3());
      if (!start) return;
      this.drag = { ...grabbed, plane, start, pointer: event.pointerId };
      this.view.controls.enabled = false;
      this.view.$el.setPointerCapture(event.pointerId);
      event.stopPropagation();
      event.preventDefault();
    }

    move(event) {
      const caster = this.raycaster(event);
      if (!this.drag) {
        this.view.$el.style.cursor = this.hitTest(caster) ? "grab" : "";
        return;
      }
      event.stopPropagation();
      const at = caster.ray.intersectPlane(this.drag.plane, new this.THREE.Vector3());
      if (at) this.dragTo(at);
    }

    // now: even if the last message was sent only just before
    send(message, now = false) {
      const time = performance.now();
      if (!now && time - this.lastSent < SEND_PERIOD_MS) return;
      this.lastSent = time;
      pendant.send(message);
    }

    endDrag(event) {
      const { drag } = this;
      if (!drag) return;
      event?.stopPropagation();
      this.drag = null;
      this.view.controls.enabled = true;
      if (this.view.$el.hasPointerCapture?.(drag.pointer)) this.view.$el.releasePointerCapture(drag.pointer);
      this.drop(drag);
    }
  };

  // Returns the position of a point of a scene in pixels of the page.
  pendant.toPixels = (view, point) => {
    const at = point.clone().project(view.camera);
    const box = view.renderer.domElement.getBoundingClientRect();
    return [box.left + ((at.x + 1) / 2) * box.width, box.top + ((1 - at.y) / 2) * box.height];
  };

  pendant.addScene = (id) => {
    scenes.set(id, { scene: null, angles: null, ghost: null, path: null });
    pendant.followers.set(id, (angles) => {
      scenes.get(id).angles = angles;
      const scene = getElement(id);
      if (scene?.scene?.getObjectByName("trace")?.visible) setJoints(id, scene); // the trace gets more points than frames
    });
  };

  setInterval(() => [...scenes.keys()].forEach(setUp), 200);
  new MutationObserver(() => [...scenes.keys()].forEach((id) => getElement(id)?.renderer && paint(getElement(id)))).observe(
    document.body,
    { attributeFilter: ["class"] },
  );

  // For feature View: the angle from the x axis of the base to the direction that is right in the view.
  pendant.context.azimuth = () => {
    const visible = [...scenes.keys()].map(getElement).find((scene) => scene?.camera && scene.$el.offsetParent);
    if (!visible) return 0;
    const [x, y] = visible.camera.matrixWorld.elements;
    return Math.atan2(y, x);
  };
})();
