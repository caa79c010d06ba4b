"use strict";
// The arms and objects of a trace in 3D. Axes are those of the robot's base.
const traceScene = (() => {
  const OTHER_COLOR = "#e07b00"; // the arm of the run that is compared
  const PATHS = ["#d81b8c", OTHER_COLOR]; // the path of the TCP in each run
  const MARK = 0.014; // radius of a waypoint, of the arm's reach
  const SEGMENTS = 28;
  const AXES = ["#d6453d", "#3d9a4a", "#2f6fd0"];

  function lathe(THREE, [profile, origin, axis, color], other) {
    const points = profile.map(([radius, z]) => new THREE.Vector2(radius, z));
    const look = other ? { color: OTHER_COLOR, transparent: true, opacity: 0.4 } : { color };
    const solid = new THREE.Mesh(new THREE.LatheGeometry(points, SEGMENTS).rotateX(Math.PI / 2), new THREE.MeshPhongMaterial({ ...look, side: THREE.DoubleSide }));
    solid.position.set(...origin);
    solid.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(...axis));
    return solid;
  }

  class Arm {
    constructor(THREE, run, other) {
      this.THREE = THREE;
      this.run = run;
      this.root = new THREE.Group();
      this.joints = [];
      let parent = this.root;
      run.links.forEach((parts, i) => {
        if (i) {
          const [position, m] = run.chain[i - 1];
          const frame = new THREE.Group();
          frame.position.set(...position);
          frame.setRotationFromMatrix(new THREE.Matrix4().set(m[0], m[1], m[2], 0, m[3], m[4], m[5], 0, m[6], m[7], m[8], 0, 0, 0, 0, 1));
          const joint = new THREE.Group();
          frame.add(joint);
          parent.add(frame);
          this.joints.push(joint);
          parent = joint;
        }
        for (const part of parts) parent.add(lathe(THREE, part, other));
      });
      this.flange = parent;
      this.addTcp(other);
      this.addWaypoints(other);
      this.objects = Object.entries(run.objects).map(([name, description]) => {
        const mesh = shapes.createObject(THREE, description, other ? OTHER_COLOR : undefined);
        this.root.add(mesh);
        return { mesh, columns: run.columns[`object ${name}`] };
      });
    }

    addTcp(other) {
      const { THREE, run } = this;
      const pose = (this.pose = run.columns.actual_TCP_pose);
      if (!pose) return;
      this.tcp = new THREE.Group();
      AXES.forEach((color, i) => this.tcp.add(new THREE.ArrowHelper(new THREE.Vector3().setComponent(i, 1), new THREE.Vector3(), 0.15 * run.reach, color)));
      this.rod = new THREE.Line(new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3(1, 0, 0)]), new THREE.LineBasicMaterial({ color: "#8a949d" }));
      const points = [];
      for (let row = 0; row < run.samples; row++) {
        const at = new THREE.Vector3(pose[0][row], pose[1][row], pose[2][row]);
        if (!points.length || points.at(-1).distanceTo(at) > 0.001) points.push(at);
      }
      const path = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: PATHS[+other] }));
      this.root.add(this.tcp, this.rod, path);
    }

    addWaypoints(other) {
      const { THREE, run } = this;
      const geometry = new THREE.SphereGeometry(MARK * run.reach, 12, 8);
      const material = new THREE.MeshBasicMaterial({ color: PATHS[+other] });
      this.waypoints = (run.waypoints || []).map((position) => {
        const mark = new THREE.Mesh(geometry, material);
        mark.position.set(...position);
        this.root.add(mark);
        return mark;
      });
    }

    set(row) {
      const { THREE, run } = this;
      const q = run.columns.actual_q;
      if (q) this.joints.forEach((joint, i) => (joint.rotation.z = q[i][row]));
      for (const { mesh, columns } of this.objects) {
        mesh.visible = !Number.isNaN(columns[0][row]);
        if (mesh.visible) shapes.setPose(THREE, mesh, columns.map((column) => column[row]));
      }
      if (!this.pose) return;
      shapes.setPose(THREE, this.tcp, this.pose.map((column) => column[row]));
      this.root.updateMatrixWorld(true);
      const ends = [this.flange.getWorldPosition(new THREE.Vector3()), this.tcp.position];
      this.rod.geometry.setFromPoints(ends);
    }
  }

  // Builds the view in an element; returns a function that shows rows of the runs, -1 for none.
  function build(THREE, OrbitControls, box, runs) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const renderer = new THREE.WebGLRenderer({ antialias: true });
    renderer.setClearColor(dark ? "#1a2128" : "#e9edf1");
    renderer.setPixelRatio(window.devicePixelRatio || 1);
    box.append(renderer.domElement);
    const scene = new THREE.Scene();
    const reach = runs[0].reach;
    const camera = new THREE.PerspectiveCamera(38, 1, 0.02, 60);
    camera.position.set(2.0 * reach, -2.1 * reach, 1.5 * reach);
    const controls = new OrbitControls(camera, renderer.domElement);
    controls.target.set(0, 0, 0.45 * reach);
    scene.add(new THREE.AmbientLight("#ffffff", 1.7));
    for (const [intensity, ...place] of [[1.5, 2, -3, 5], [0.9, -4, 3, 2]]) {
      const light = new THREE.DirectionalLight("#ffffff", intensity);
      light.position.set(...place);
      scene.add(light);
    }
    const grid = new THREE.GridHelper(4, 40, dark ? "#4a5864" : "#9fb0bd", dark ? "#2c3741" : "#d3dbe2").rotateX(Math.PI / 2);
    grid.position.z = -0.002;
    scene.add(grid);
    const arms = runs.map((run, i) => new Arm(THREE, run, i > 0));
    for (const arm of arms) scene.add(arm.root);
    let waiting = false;
    const render = () => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => {
        waiting = false;
        renderer.render(scene, camera);
      });
    };
    controls.addEventListener("change", render);
    new ResizeObserver(() => {
      const { clientWidth, clientHeight } = box;
      if (!clientWidth || !clientHeight) return;
      renderer.setSize(clientWidth, clientHeight);
      camera.aspect = clientWidth / clientHeight;
      camera.updateProjectionMatrix();
      render();
    }).observe(box);
    controls.update();
    return {
      arms,
      show(rows) {
        arms.forEach((arm, i) => {
          arm.root.visible = rows[i] >= 0;
          if (rows[i] >= 0) arm.set(rows[i]);
        });
        render();
      },
    };
  }

  return { build, PATHS };
})();
