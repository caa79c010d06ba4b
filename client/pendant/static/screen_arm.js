"use strict";
// The arm in a NiceGUI scene: see client/pendant/arm_scene.py.
(() => {
  const scenes = new Map(); // element id -> its THREE scene, and the joints' angles

  const colors = () =>
    document.body.classList.contains("body--dark")
      ? { background: "#1a2128", ground: "#1f2830", grid: 0.12 }
      : { background: "#e9edf1", ground: "#e4e9ee", grid: 0.2 };

  function paint(scene) {
    const { background, ground, grid } = colors();
    scene.renderer.setClearColor(background); // seen with the ground's new colour
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
      const other = child.clone(); // from the other side, so that no side is flat
      other.intensity = 0.9;
      other.position.set(-4, 3, 2);
      scene.scene.add(other);
    }
  }

  // A number that is another one when something has moved; sines keep moves from adding up to nothing.
  function looks(scene) {
    let sum = scene.$el.clientWidth + 3 * scene.$el.clientHeight;
    let i = 1;
    const add = (value) => (sum += value * Math.sin(i++));
    const addMatrix = (object) => object.matrix.elements.forEach(add);
    scene.scene.traverse((object) => {
      object.updateMatrix();
      addMatrix(object);
      if (object.visible) add(1);
      if (object.name === "trace") add(object.geometry.attributes.position.version);
      if (object.material?.color) add(object.material.color.getHex() + object.material.opacity);
    });
    scene.camera.updateMatrix();
    addMatrix(scene.camera);
    return sum;
  }

  // Keeps to the size of its place; in a narrow one it looks wider, so that the arm is in it.
  function fit(scene) {
    const { clientWidth, clientHeight } = scene.$el;
    if (!clientWidth || !clientHeight) return;
    const wide = Math.max(1, (0.75 * clientHeight) / clientWidth);
    const half = (scene.cameraParams.fov * Math.PI) / 360;
    scene.camera.fov = (360 / Math.PI) * Math.atan(Math.tan(half) * wide);
    scene.resize();
  }

  // Renders only what somebody sees, and only when it has changed: graphics may be slow, and batteries small.
  function render(id, scene) {
    const draw = scene.renderer.render.bind(scene.renderer);
    let last = null;
    scene.renderer.render = (...what) => {
      if (!scene.$el.offsetParent) return;
      turn(id, scene);
      const now = looks(scene);
      if (now === last) return;
      last = now;
      draw(...what);
    };
    new ResizeObserver(() => fit(scene)).observe(scene.$el);
  }

  // A scene is made anew when its browser's graphics were lost.
  function dress(id) {
    const scene = getElement(id);
    if (!scene || !scene.renderer || !scene.controls) return;
    const known = scenes.get(id);
    if (known.scene === scene.scene) return;
    known.scene = scene.scene;
    light(scene);
    paint(scene);
    render(id, scene);
  }

  // Joints are groups that are called "joint 0" and so on, those of the ghost "ghost joint 0".
  function turn(id, scene) {
    const { angles, ghost } = scenes.get(id);
    scene.scene.traverse((object) => {
      if (angles && object.name.startsWith("joint ")) object.rotation.z = angles[object.name.slice(6)];
      if (ghost && object.name.startsWith("ghost joint ")) object.rotation.z = ghost[object.name.slice(12)];
      if (object.name === "ghost") object.visible = Boolean(ghost);
    });
    if (angles) trace(scene.scene);
  }

  // One more point of the TCP's way, if it is shown and the TCP has moved.
  function trace(scene) {
    const line = scene.getObjectByName("trace");
    const tcp = scene.getObjectByName("tcp");
    if (!line?.visible || !tcp) return;
    tcp.updateWorldMatrix(true, false);
    const [x, y, z] = tcp.matrixWorld.elements.slice(12);
    const { geometry } = line;
    const points = geometry.attributes.position;
    let count = geometry.drawRange.count;
    const far = (i) => Math.hypot(points.getX(i) - x, points.getY(i) - y, points.getZ(i) - z);
    if (count && far(count - 1) < 0.001) return;
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

  pendant.dress = (id) => {
    scenes.set(id, { scene: null, angles: null, ghost: null });
    pendant.followers.set(id, (angles) => {
      scenes.get(id).angles = angles;
      const scene = getElement(id);
      if (scene?.scene?.getObjectByName("trace")?.visible) turn(id, scene); // its way is finer than its pictures
    });
  };

  setInterval(() => [...scenes.keys()].forEach(dress), 200);
  new MutationObserver(() => [...scenes.keys()].forEach((id) => getElement(id)?.renderer && paint(getElement(id)))).observe(
    document.body,
    { attributeFilter: ["class"] },
  );

  // For feature View: how far what the camera calls right is turned from the base's x axis.
  pendant.context.azimuth = () => {
    const seen = [...scenes.keys()].map(getElement).find((scene) => scene?.camera && scene.$el.offsetParent);
    if (!seen) return 0;
    const [x, y] = seen.camera.matrixWorld.elements;
    return Math.atan2(y, x);
  };
})();
