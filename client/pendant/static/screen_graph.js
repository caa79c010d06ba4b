"use strict";
// Live diagrams: see client/pendant/plots.py. They are drawn by urproto/trace/static/curves.js.
(() => {
  const MAX_ROWS = 80000;
  const CLOCK_STEP_S = 0.5; // a time stamp that is older by this much is from another clock: all samples are dropped

  let config = null;
  let columnOf = new Map(); // key -> column
  let width = 1;
  let capacity = 0;
  let count = 0;
  let data = new Float64Array(0); // all rows, one after the other
  let pausedAt = null; // time of the right edge
  let cursor = null; // x as a fraction of the width of the diagram
  let drawing = false;
  let lastTexts = 0;
  const hidden = new Set();
  const ranges = new WeakMap(); // canvas -> [low, high]
  const legends = new WeakMap(); // legend -> { version, values }
  const watched = new WeakSet();

  const time = (row) => data[row * width];

  function begin(columns) {
    columnOf = new Map(columns.map((key, index) => [key, index]));
    width = columns.length;
    capacity = 0;
    count = 0;
    data = new Float64Array(0);
  }

  function add(numbers) {
    const rows = numbers.length / width;
    if (rows && count && numbers[0] < time(count - 1) - CLOCK_STEP_S) count = 0;
    if (count + rows > MAX_ROWS) {
      const drop = Math.max(MAX_ROWS >> 3, count + rows - MAX_ROWS);
      data.copyWithin(0, drop * width, count * width);
      count -= drop;
    }
    if (count + rows > capacity) {
      capacity = Math.min(MAX_ROWS, Math.max(4096, 2 * (count + rows)));
      const larger = new Float64Array(capacity * width);
      larger.set(data.subarray(0, count * width));
      data = larger;
    }
    const start = count * width;
    for (let i = 0; i < numbers.length; i++) data[start + i] = numbers[i] === null ? NaN : numbers[i];
    count += rows;
  }

  pendant.receivers.samples = ([columns, numbers]) => {
    if (columns) begin(columns);
    add(numbers);
    if (pausedAt === null) schedule();
  };

  pendant.receivers.plot = (value) => {
    const panes = value.panes.map((pane) => ({ ...pane, box: document.getElementById(`c${pane.canvas}`), list: document.getElementById(`c${pane.legend}`) }));
    if (panes.some((pane) => !pane.box || !pane.list)) return false;
    config = { ...value, panes };
    pausedAt = config.paused ? (pausedAt ?? (count ? time(count - 1) : 0)) : null;
    for (const pane of panes) {
      watch(pane.box);
      buildLegend(pane);
    }
    schedule();
  };

  // pointer and size

  function watch(canvas) {
    if (watched.has(canvas)) return;
    watched.add(canvas);
    new ResizeObserver(schedule).observe(canvas);
    const move = (event) => {
      const box = canvas.getBoundingClientRect();
      const fraction = (event.clientX - box.left - curves.MARGIN.left) / (box.width - curves.MARGIN.left - curves.MARGIN.right);
      cursor = fraction >= 0 && fraction <= 1 ? fraction : null;
      schedule();
    };
    canvas.addEventListener("pointermove", move);
    canvas.addEventListener("pointerdown", move);
    canvas.addEventListener("pointerleave", (event) => {
      if (event.pointerType === "touch") return; // the cursor stays where the finger was
      cursor = null;
      schedule();
    });
  }

  function buildLegend(pane) {
    pane.list.replaceChildren();
    const values = pane.series.map((series, index) => {
      const entry = document.createElement("button");
      entry.type = "button";
      entry.className = "legend-entry";
      entry.dataset.key = series.key;
      entry.dataset.state = hidden.has(series.key) ? "hidden" : "shown";
      const line = document.createElement("i");
      line.style.background = curves.color(index);
      const name = document.createElement("span");
      name.textContent = series.label;
      const value = document.createElement("b");
      const unit = document.createElement("em");
      unit.textContent = series.unit;
      entry.append(line, name, value, unit);
      entry.addEventListener("click", () => {
        if (!hidden.delete(series.key)) hidden.add(series.key);
        entry.dataset.state = hidden.has(series.key) ? "hidden" : "shown";
        schedule();
      });
      pane.list.append(entry);
      return value;
    });
    if (!pane.series.length) pane.list.textContent = "Select signals with the button on the right.";
    legends.set(pane.list, values);
    lastTexts = 0;
  }

  // drawing

  function schedule() {
    if (drawing) return;
    drawing = true;
    requestAnimationFrame(() => {
      drawing = false;
      draw();
    });
  }

  function draw() {
    if (!config) return;
    const right = pausedAt ?? (count ? time(count - 1) : 0);
    const view = { left: right - config.window, right };
    const first = Math.max(curves.rowAt(time, count, view.left) - 1, 0);
    const last = Math.min(curves.rowAt(time, count, view.right + 1e-9), count);
    const row = cursor === null ? last - 1 : Math.min(Math.max(curves.nearest(time, count, view.left + cursor * config.window), first), last - 1);
    const now = performance.now();
    const texts = cursor !== null || now - lastTexts > 100;
    if (texts) lastTexts = now;
    for (const pane of config.panes) {
      if (!pane.box.isConnected || !pane.box.clientWidth) continue;
      drawPane(pane, view, first, last, row);
      if (texts) showValues(pane, row);
    }
  }

  function showValues(pane, row) {
    const values = legends.get(pane.list);
    pane.series.forEach((series, index) => {
      const column = columnOf.get(series.key);
      const value = row >= 0 && column !== undefined ? data[row * width + column] * series.factor : NaN;
      const text = Number.isNaN(value) ? "-" : series.steps ? String(value) : value.toFixed(3);
      if (values[index].textContent !== text) values[index].textContent = text;
    });
  }

  function drawPane(pane, view, first, last, row) {
    const canvas = pane.box;
    const drawn = curves.begin(canvas);
    if (!drawn) return;
    const lines = pane.series.flatMap(({ key, factor, steps }, index) => {
      const column = columnOf.get(key);
      if (hidden.has(key) || column === undefined) return [];
      const value = (row) => data[row * width + column] * factor;
      return [{ time, value, first, last, steps, color: curves.color(index) }];
    });
    ranges.set(canvas, curves.draw(drawn, view, lines, pane.auto ? null : ranges.get(canvas)));
    if (cursor !== null && row >= first && row < last) curves.drawCursor(drawn, view, time(row));
  }

  // export: a picture of all diagrams with their legends

  pendant.savePlots = () => {
    if (!config) return;
    draw();
    const ratio = window.devicePixelRatio || 1;
    const head = 26;
    const panes = config.panes.filter((pane) => pane.box.clientWidth);
    const picture = document.createElement("canvas");
    picture.width = Math.max(...panes.map((pane) => pane.box.width));
    picture.height = panes.reduce((sum, pane) => sum + pane.box.height + head * ratio, 0);
    const pen = picture.getContext("2d");
    const style = getComputedStyle(panes[0].box);
    pen.fillStyle = style.getPropertyValue("--panel");
    pen.fillRect(0, 0, picture.width, picture.height);
    let top = 0;
    for (const pane of panes) {
      drawLegend(pen, style, pane, top, ratio, picture.width / ratio);
      pen.drawImage(pane.box, 0, top + head * ratio);
      top += head * ratio + pane.box.height;
    }
    picture.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${config.name}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 10000);
    }, "image/png");
  };

  function drawLegend(pen, style, pane, top, ratio, right) {
    pen.save();
    pen.setTransform(ratio, 0, 0, ratio, 0, top);
    pen.font = "12px Roboto, sans-serif";
    pen.textBaseline = "middle";
    let x = curves.MARGIN.left;
    pane.series.forEach((series, index) => {
      if (hidden.has(series.key)) return;
      const text = series.unit ? `${series.label} [${series.unit}]` : series.label;
      const size = pen.measureText(text).width;
      if (x + size + 16 > right) return;
      pen.fillStyle = curves.color(index);
      pen.fillRect(x, 12, 12, 3);
      pen.fillStyle = style.getPropertyValue("--ink");
      pen.fillText(text, x + 16, 14);
      x += size + 32;
    });
    pen.restore();
  }
})();
