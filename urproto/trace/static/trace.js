"use strict";
// The page of a trace: see urproto/trace/page.py. A moment is in the address as #t=12.400.
(async () => {
  const TICKS_PER_S = 10000; // of the times of samples
  const MARGIN = { left: 104, right: 10, top: 4, bottom: 4 };
  const LANE_PX = 18;
  const STATES = ["#8fb8d8", "#a9cfa4", "#c9b3e0", "#e3cf8e", "#9ed3d6", "#e2b4c8", "#c3cb95", "#b7bdf0"];
  const LEVELS = { error: "#e57373", warning: "#f0b94d" };
  const SHOWN = 200; // events in the list
  const STREAM = 1000; // a lane with more entries is in the list only when it is searched for
  const FIRST_CURVES = ["Joint positions", "Joint speeds", "TCP position"];
  const SAME_RAD = 0.001; // guess: angles that differ by less cannot be told apart in the picture
  const $ = (id) => document.getElementById(id);
  const make = (tag, properties, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };

  // data

  async function bytesOf(id) {
    const text = $(id).textContent.trim();
    const letters = atob(text);
    const packed = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) packed[i] = letters.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  function unpack(bytes) {
    let at = 4 + new DataView(bytes.buffer).getUint32(0, true);
    const run = JSON.parse(new TextDecoder().decode(bytes.subarray(4, at)));
    const count = run.samples;
    const column = () => {
      const bits = new Int32Array(count);
      let sum = 0;
      for (let i = at; i < at + count; i++) {
        sum = (sum + (bytes[i] | (bytes[i + count] << 8) | (bytes[i + 2 * count] << 16) | (bytes[i + 3 * count] << 24))) | 0;
        bits[i - at] = sum;
      }
      at += 4 * count;
      return bits;
    };
    const ticks = column();
    run.time = (row) => run.start + ticks[row] / TICKS_PER_S;
    const sizes = Object.entries(run.columns);
    run.columns = Object.fromEntries(sizes.map(([name, size]) => [name, Array.from({ length: size }, () => new Float32Array(column().buffer))]));
    for (const lane of run.lanes) lane.entries = lane.entries.map(([time, text, level = "", detail = "", place]) => ({ time, text, level, detail, place, lane }));
    run.shift = 0;
    run.row = (seconds) => curves.rowAt(run.time, count, seconds - run.shift + 1e-6) - 1; // -1 before its beginning
    return run;
  }

  const run = unpack(await bytesOf("run"));
  const other = $("other").textContent.trim() ? unpack(await bytesOf("other")) : null;
  const runs = other ? [run, other] : [run];
  JSON.parse($("details").textContent).forEach((detail, i) => Object.assign(runs[i], detail));
  const begin = run.time(0);
  const end = Math.max(run.time(run.samples - 1), begin + 0.01);
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const lastOf = (lane, seconds) => lane.entries[curves.rowAt((row) => lane.entries[row].time, lane.entries.length, seconds + 1e-6) - 1];

  let now = begin;
  let view = { left: begin, right: end };
  let playing = null; // { since, from }
  let difference = null;
  let three = null;
  const hidden = new Set(); // parts of curves: "Base"
  const shown = new Set(FIRST_CURVES);

  // where we are

  function go(seconds, { follow = true } = {}) {
    now = clamp(seconds, begin, end);
    const width = view.right - view.left;
    if (follow && (now < view.left || now > view.right)) show(now - width / 2, now + width / 2);
    draw();
  }

  function show(left, right) {
    const width = clamp(right - left, 0.02, end - begin);
    left = clamp(left, begin, end - width);
    view = { left, right: left + width };
    draw();
  }

  const zoom = (factor, around = clamp(now, view.left, view.right)) => show(around - (around - view.left) * factor, around + (view.right - around) * factor);
  const step = (by) => go(run.time(clamp(run.row(now) + by, 0, run.samples - 1)));

  function play(on = !playing) {
    if (on && now >= end) now = begin;
    playing = on ? { since: performance.now(), from: now } : null;
    $("play").setAttribute("aria-pressed", String(on));
    if (on) requestAnimationFrame(tick);
  }

  function tick() {
    if (!playing) return;
    go(playing.from + (performance.now() - playing.since) / 1000);
    if (now >= end) play(false);
    else requestAnimationFrame(tick);
  }

  function event(by) {
    const at = curves.rowAt((row) => found[row].time, found.length, now + (by > 0 ? 5e-5 : -5e-5));
    const next = found[by > 0 ? at : at - 1];
    if (next) select(next);
  }

  function select(entry) {
    go(entry.time);
    $("detail").hidden = !entry.detail;
    $("detail").textContent = entry.detail;
  }

  let saving = 0;
  function saveMoment() {
    clearTimeout(saving);
    saving = setTimeout(() => history.replaceState(null, "", `#t=${now.toFixed(3)}`), 200);
  }

  function openMoment() {
    const seconds = /^#t=(\d+(\.\d+)?)$/.exec(location.hash)?.[1];
    if (seconds !== undefined) go(Number(seconds));
  }

  // drawing

  let drawing = false;
  function draw() {
    if (drawing) return;
    drawing = true;
    requestAnimationFrame(() => {
      drawing = false;
      $("clock").textContent = `${now.toFixed(3)} s`;
      drawLanes();
      drawPanes();
      showSource();
      markEvents();
      three?.show(runs.map((one) => one.row(now)));
      saveMoment();
    });
  }

  const xOf = (area, seconds) => area.left + ((seconds - view.left) / (view.right - view.left)) * area.width;

  const lanes = run.lanes.map((lane) => [lane, other?.lanes.find(({ name }) => name === lane.name)]);
  for (const lane of other?.lanes || []) if (!run.lanes.some(({ name }) => name === lane.name)) lanes.push([null, lane]);

  function drawLanes() {
    const canvas = $("lanes");
    canvas.style.height = `${lanes.length * LANE_PX + MARGIN.top + MARGIN.bottom}px`;
    const drawn = curves.begin(canvas, MARGIN);
    if (!drawn) return;
    const { pen, area, style } = drawn;
    lanes.forEach((pair, i) => {
      const top = area.top + i * LANE_PX;
      pen.font = "11px Roboto, sans-serif";
      pen.textBaseline = "middle";
      pen.textAlign = "right";
      pen.fillStyle = style.getPropertyValue("--ink");
      pen.fillText((pair[0] || pair[1]).name, area.left - 6, top + LANE_PX / 2, area.left - 8);
      pen.strokeStyle = style.getPropertyValue("--line");
      pen.strokeRect(area.left, top + 0.5, area.width, LANE_PX - 1);
      const height = (LANE_PX - 2) / (other ? 2 : 1);
      curves.clipped(pen, area, () =>
        pair.forEach((lane, second) => lane && drawLane(pen, style, area, lane, top + 1 + second * height, height, second ? other.shift : 0)),
      );
    });
    if (difference) drawDifference(drawn);
    curves.drawCursor(drawn, view, now, false);
  }

  function drawLane(pen, style, area, { entries, states }, top, height, shift) {
    const first = Math.max(curves.rowAt((row) => entries[row].time + shift, entries.length, view.left) - (states ? 1 : 0), 0);
    let free = -1; // x from which on nothing is drawn yet
    pen.textAlign = "left";
    for (let i = first; i < entries.length && entries[i].time + shift <= view.right; i++) {
      const { time, text, level } = entries[i];
      const x = Math.max(xOf(area, time + shift), area.left - 1);
      const until = i + 1 < entries.length ? xOf(area, entries[i + 1].time + shift) : states ? xOf(area, end) : area.left + area.width;
      if ((states && !text) || (until - free < 1 && i + 1 < entries.length && !level)) continue;
      pen.fillStyle = LEVELS[level] || (states ? colorOf(text) : "#6f9fc4");
      pen.fillRect(x, top, states ? Math.max(until - x - 0.5, 1) : 2, height);
      free = states ? until : x + 1;
      if (height < 12 || until - x < 30) continue;
      pen.fillStyle = states ? "#1d2730" : style.getPropertyValue("--soft");
      const room = Math.floor((until - x - 8) / 5.5);
      pen.fillText(text.length > room ? `${text.slice(0, room - 1)}…` : text, x + 4, top + height / 2 + 0.5);
    }
  }

  const colors = new Map();
  const colorOf = (text) => colors.get(text) || colors.set(text, STATES[colors.size % STATES.length]).get(text);

  function drawDifference({ pen, area }) {
    const x = xOf(area, difference.time);
    if (x < area.left || x > area.left + area.width) return;
    pen.fillStyle = LEVELS.error;
    pen.fillRect(x - 1, area.top, 2, area.height);
  }

  let panes = [];
  function buildPanes() {
    panes = run.curves.filter(({ title }) => shown.has(title)).map((set) => {
      const buttons = set.parts.map((part, index) => {
        const button = make("button", { ariaPressed: String(!hidden.has(part)) }, make("i"), part, make("b"));
        button.firstChild.style.background = curves.color(index);
        button.onclick = () => {
          if (!hidden.delete(part)) hidden.add(part);
          buildPanes();
        };
        return button;
      });
      const legend = make("div", { className: "legend" }, make("h2", {}, set.unit ? `${set.title} [${set.unit}]` : set.title), ...buttons);
      const canvas = make("canvas", { role: "img", ariaLabel: `${set.title} over time; the values at the cursor are in the legend` });
      watch(canvas);
      return { set, canvas, pane: make("div", { className: "pane" }, legend, canvas), values: buttons.map((button) => button.lastChild) };
    });
    $("panes").replaceChildren(...panes.map(({ pane }) => pane));
    draw();
  }

  function linesOf(one, { actual, target, first }, index, second) {
    return [[target, [5, 4]], [actual, second ? [2, 2] : []]].flatMap(([name, dash]) => {
      const column = one.columns[name]?.[first + index];
      if (!column || (second && name === target)) return [];
      const time = (row) => one.time(row) + one.shift;
      const from = Math.max(curves.rowAt(time, one.samples, view.left) - 1, 0);
      const last = Math.min(curves.rowAt(time, one.samples, view.right) + 1, one.samples);
      return [{ time, value: (row) => column[row], first: from, last, dash, color: curves.color(index) }];
    });
  }

  function drawPanes() {
    const row = run.row(now);
    for (const { set, canvas, values } of panes) {
      const drawn = curves.begin(canvas, { ...MARGIN, top: 6, bottom: 20 });
      if (!drawn) continue;
      const lines = set.parts.flatMap((part, index) => (hidden.has(part) ? [] : runs.flatMap((one, i) => linesOf(one, set, index, i > 0))));
      curves.draw(drawn, view, lines, null);
      if (difference) drawDifference(drawn);
      curves.drawCursor(drawn, view, now);
      values.forEach((value, index) => {
        const [actual, target] = [set.actual, set.target].map((name) => run.columns[name]?.[set.first + index][row]);
        const text = [actual, target].filter((number) => number !== undefined).map((number) => number.toFixed(3));
        value.textContent = text.join(" / ");
      });
    }
  }

  // the program

  let listed = -1; // number of the program that is shown
  const threads = run.lanes.filter(({ entries }) => entries.some(({ place }) => place));

  function showSource() {
    const places = threads.map((lane) => lastOf(lane, now)?.place).filter(Boolean);
    const number = places[0]?.[0] ?? (listed < 0 && run.programs.length ? 0 : listed);
    if (number !== listed) {
      const lines = (run.programs[number] || "").split("\n");
      $("source").replaceChildren(...lines.map((text, i) => make("div", {}, `${String(i + 1).padStart(4)}  ${text}`)));
      listed = number;
    }
    const current = new Set(places.filter(([program]) => program === listed).map(([, line]) => line));
    [...$("source").children].forEach((line, i) => line.toggleAttribute("data-current", current.has(i + 1)));
    const first = $("source").querySelector("[data-current]");
    if (first) $("source").scrollTop = first.offsetTop - $("source").offsetTop - $("source").clientHeight / 2;
    $("source").hidden = !run.programs.length;
  }

  // events

  const all = run.lanes.flatMap(({ entries }) => entries).filter(({ text }) => text).sort((a, b) => a.time - b.time);
  let found = [];
  let first = -1; // of the found events in the list

  function search() {
    const word = $("search").value.trim().toLowerCase();
    const has = ({ text, detail, lane }) => `${lane.name} ${text} ${detail}`.toLowerCase().includes(word);
    found = all.filter(word ? has : ({ place, lane }) => !place && lane.entries.length <= STREAM);
    const lines = word ? run.programs.flatMap((source) => source.split("\n").filter((line) => line.toLowerCase().includes(word))) : [];
    $("found").textContent = `${found.length} events${lines.length ? `, ${lines.length} lines of programs` : ""}`;
    first = -1;
    markEvents();
  }

  function markEvents() {
    const current = curves.rowAt((row) => found[row].time, found.length, now + 1e-4) - 1;
    if (first < 0 || current < first || current >= first + SHOWN) {
      first = clamp(current - SHOWN / 4, 0, Math.max(found.length - SHOWN, 0)) | 0;
      $("events").replaceChildren(...found.slice(first, first + SHOWN).map(row));
    }
    $("events").querySelector("[aria-current]")?.removeAttribute("aria-current");
    const mark = $("events").children[current - first]?.firstChild;
    mark?.setAttribute("aria-current", "true");
    if (mark) $("events").scrollTop = mark.offsetTop - $("events").offsetTop - $("events").clientHeight / 2;
  }

  function row(entry) {
    const text = make("span", { className: entry.level }, make("small", {}, `${entry.lane.name}: `), entry.text);
    return make("li", {}, make("button", { onclick: () => select(entry) }, make("span", {}, entry.time.toFixed(3)), text));
  }

  // comparison

  // The runs are laid over each other where their first programs start, or at their beginnings.
  function startOf(one) {
    const program = one.lanes.find(({ name }) => name === "Program");
    return program?.entries.find(({ text }) => text === "PLAYING")?.time ?? one.time(0);
  }

  function compare() {
    const both = runs.map(startOf);
    other.shift = both[0] - both[1] + Number($("shift").value);
    const candidates = [firstJointDifference(), ...lanes.map(([one, its]) => firstStateDifference(one, its))];
    difference = candidates.filter(Boolean).sort((a, b) => a.time - b.time)[0] || null;
    $("difference").textContent = `Compared with ${other.title}: ${difference ? `first difference at ${difference.time.toFixed(3)} s, ${difference.text}` : "no difference"}.`;
    $("there").hidden = !difference;
    draw();
  }

  function firstJointDifference() {
    const [mine, its] = runs.map((one) => one.columns.actual_q);
    if (!mine || !its) return null;
    for (let i = 0; i < run.samples; i++) {
      const time = run.time(i);
      const j = other.row(time);
      if (j < 0 || j > other.samples - 2) continue;
      const fraction = (time - other.shift - other.time(j)) / (other.time(j + 1) - other.time(j));
      const angles = its.map((column) => column[j] + fraction * (column[j + 1] - column[j])); // its samples are at other times
      const joint = mine.findIndex((column, k) => Math.abs(column[i] - angles[k]) > SAME_RAD);
      if (joint >= 0) return { time, text: `${run.curves[0].parts[joint]}: ${mine[joint][i].toFixed(4)} and ${angles[joint].toFixed(4)} rad` };
    }
    return null;
  }

  function firstStateDifference(one, its) {
    if (!one?.states || !its) return null;
    const last = Math.min(end, other.time(other.samples - 1) + other.shift);
    const changes = [...one.entries.map(({ time }) => time), ...its.entries.map(({ time }) => time + other.shift)];
    for (const time of changes.sort((a, b) => a - b)) {
      if (time < Math.max(begin, other.time(0) + other.shift) || time > last) continue;
      const [a, b] = [lastOf(one, time + 1e-4)?.text || "-", lastOf(its, time + 1e-4 - other.shift)?.text || "-"];
      if (a !== b) return { time, text: `${one.name}: ${a} and ${b}` };
    }
    return null;
  }

  // input

  function watch(canvas) {
    const secondsAt = ({ clientX }) => {
      const { left, width } = canvas.getBoundingClientRect();
      return view.left + ((clientX - left - MARGIN.left) / (width - MARGIN.left - MARGIN.right)) * (view.right - view.left);
    };
    let pan = null;
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pan = event.shiftKey || event.button === 1 ? { x: event.clientX, ...view } : null;
      if (!pan) go(secondsAt(event), { follow: false });
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!canvas.hasPointerCapture(event.pointerId)) return;
      if (!pan) return go(secondsAt(event), { follow: false });
      const by = ((pan.x - event.clientX) / (canvas.clientWidth - MARGIN.left - MARGIN.right)) * (pan.right - pan.left);
      show(pan.left + by, pan.right + by);
    });
    canvas.addEventListener("wheel", (event) => {
      const along = event.shiftKey ? event.deltaY : event.deltaX;
      const by = (along / canvas.clientWidth) * (view.right - view.left);
      if (along) show(view.left + by, view.right + by);
      else zoom(event.deltaY > 0 ? 1.25 : 0.8, clamp(secondsAt(event), view.left, view.right));
      event.preventDefault();
    }, { passive: false });
    new ResizeObserver(draw).observe(canvas);
  }

  const ACTIONS = {
    home: ["Home", () => go(begin)], previous: ["[", () => event(-1)], back: ["ArrowLeft", () => step(-1)], play: [" ", () => play()],
    forward: ["ArrowRight", () => step(1)], next: ["]", () => event(1)], end: ["End", () => go(end)],
    closer: ["+", () => zoom(0.5)], wider: ["-", () => zoom(2)], whole: ["0", () => show(begin, end)],
  };
  const keys = new Map(Object.values(ACTIONS));
  for (const [id, [, act]] of Object.entries(ACTIONS)) $(id).onclick = act;
  document.addEventListener("keydown", (event) => {
    const act = keys.get(event.key);
    if (!act || event.ctrlKey || event.altKey || event.metaKey || event.target.matches("input")) return;
    if (event.key === " " && event.target.matches("button")) return; // it presses the button
    event.preventDefault();
    act();
  });
  $("search").addEventListener("input", search);
  window.addEventListener("hashchange", openMoment);

  for (const { title, actual, target } of run.curves) {
    if (!run.columns[actual] && !run.columns[target]) {
      shown.delete(title);
      continue;
    }
    const box = make("input", { type: "checkbox", checked: shown.has(title) });
    box.onchange = () => {
      if (!shown.delete(title)) shown.add(title);
      buildPanes();
    };
    $("choice").append(make("label", {}, box, title));
  }
  $("about").textContent = `${run.about}: ${begin.toFixed(3)} s to ${end.toFixed(3)} s`;
  $("comparison").hidden = $("key").hidden = !other;
  $("key").append(...runs.flatMap(({ title }, i) => [make("i", { style: `background: ${traceScene.PATHS[i]}` }), `${title} `]));
  $("shift").addEventListener("input", () => compare());
  $("there").onclick = () => go(difference.time);
  watch($("lanes"));
  buildPanes();
  search();
  if (other) compare();
  openMoment();
  try {
    const library = URL.createObjectURL(new Blob([await bytesOf("three")], { type: "text/javascript" }));
    const { THREE, OrbitControls } = await import(library);
    three = traceScene.build(THREE, OrbitControls, $("view"), runs);
    draw();
  } catch (error) {
    $("view").append(make("p", {}, `No 3D view: ${error.message}`));
  }
  window.trace = { run, other, go, now: () => now, view: () => view, arms: () => three?.arms, difference: () => difference };
  document.body.dataset.ready = "true";
})();
