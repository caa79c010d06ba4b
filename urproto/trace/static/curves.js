"use strict";
// Draws curves over time on a canvas: the pendant's diagrams, and the pages of traces. Without a library: for twelve
// signals over one minute at 125 Hz, ECharts took 0.6 s for a frame and this takes 2 ms (measured side by side on a
// machine under load).
const curves = (() => {
  const GAP_S = 0.3; // a longer time between two states is shown as a gap in the line
  const COLORS = ["#2f7fb8", "#d9542b", "#2e9e5b", "#8e5cc2", "#c79a00", "#17a2b0", "#d1498b", "#7a8b2a", "#5b6ee1", "#a0522d", "#607d8b", "#e07b39"];
  const MARGIN = { left: 66, right: 10, top: 8, bottom: 20 };

  const color = (index) => COLORS[index % COLORS.length];

  // The first of count rows that is not before a time.
  function rowAt(time, count, seconds) {
    let low = 0;
    let high = count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (time(middle) < seconds) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  function nearest(time, count, seconds) {
    const row = rowAt(time, count, seconds);
    return row > 0 && (row === count || seconds - time(row - 1) < time(row) - seconds) ? row - 1 : row;
  }

  // Adapts a canvas to its size on the page and clears it; null if it is too small to draw on.
  function begin(canvas, margin = MARGIN) {
    const ratio = window.devicePixelRatio || 1;
    const size = { x: canvas.clientWidth, y: canvas.clientHeight };
    if (canvas.width !== Math.round(size.x * ratio) || canvas.height !== Math.round(size.y * ratio)) {
      canvas.width = Math.round(size.x * ratio);
      canvas.height = Math.round(size.y * ratio);
    }
    const area = { left: margin.left, top: margin.top, width: size.x - margin.left - margin.right, height: size.y - margin.top - margin.bottom };
    if (area.width < 20 || area.height < 20) return null;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, size.x, size.y);
    return { pen, area, style: getComputedStyle(canvas) };
  }

  // Draws lines { time, value, first, last, steps, color, dash } and their grid, and returns the range of their values.
  // time, value: functions of the row. view: the times at the left and right edge. range: null to fit the lines.
  function draw({ pen, area, style }, view, lines, range) {
    const paths = lines.map((line) => thin(line, view, area));
    range = range || rangeOf(paths);
    drawGrid(pen, style, area, view, range);
    clipped(pen, area, () => lines.forEach((line, i) => drawLine(pen, area, range, paths[i], line)));
    return range;
  }

  function clipped(pen, area, act) {
    pen.save();
    pen.beginPath();
    pen.rect(area.left, area.top - 1, area.width, area.height + 2);
    pen.clip();
    act();
    pen.restore();
  }

  // Reduces a line to the width of the diagram: x in pixels, values. With several samples per pixel, these are the
  // smallest and the largest value of each pixel.
  function thin({ time, value, first, last }, view, area) {
    const scale = area.width / (view.right - view.left);
    const xs = [];
    const ys = [];
    const markGap = (row) => {
      if (row === first || time(row) - time(row - 1) <= GAP_S) return;
      xs.push(xs.at(-1));
      ys.push(NaN);
    };
    if (last - first <= 2 * area.width) {
      for (let row = first; row < last; row++) {
        markGap(row);
        xs.push(area.left + (time(row) - view.left) * scale);
        ys.push(value(row));
      }
      return { xs, ys };
    }
    let row = first;
    while (row < last) {
      markGap(row);
      const x = Math.floor((time(row) - view.left) * scale);
      let low = Infinity;
      let high = -Infinity;
      let rising = true;
      for (; row < last && Math.floor((time(row) - view.left) * scale) === x; row++) {
        const here = value(row);
        if (here < low) {
          low = here;
          rising = false;
        }
        if (here > high) {
          high = here;
          rising = true;
        }
      }
      if (low > high) {
        xs.push(area.left + x);
        ys.push(NaN);
        continue;
      }
      xs.push(area.left + x, area.left + x + 0.5);
      if (rising) ys.push(low, high);
      else ys.push(high, low);
    }
    return { xs, ys };
  }

  function rangeOf(paths) {
    let low = Infinity;
    let high = -Infinity;
    for (const { ys } of paths)
      for (const value of ys) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    if (low > high) return [0, 1];
    const middle = (low + high) / 2;
    const half = Math.max((high - low) * 0.54, Math.abs(middle) * 1e-4, 0.01);
    return [middle - half, middle + half];
  }

  function drawLine(pen, area, [low, high], { xs, ys }, line) {
    const scale = area.height / (high - low);
    const bottom = area.top + area.height;
    pen.strokeStyle = line.color;
    pen.lineWidth = 1.5;
    pen.lineJoin = "round";
    pen.setLineDash(line.dash || []);
    pen.beginPath();
    let before = NaN;
    for (let i = 0; i < xs.length; i++) {
      const y = bottom - (ys[i] - low) * scale;
      if (Number.isNaN(y)) {
        before = NaN;
        continue;
      }
      if (Number.isNaN(before)) pen.moveTo(xs[i], y);
      else {
        if (line.steps) pen.lineTo(xs[i], before);
        pen.lineTo(xs[i], y);
      }
      before = y;
    }
    pen.stroke();
    pen.setLineDash([]);
  }

  // 1, 2 or 5 times a power of ten: the step of a grid with about this many lines.
  function stepOf(span, steps) {
    const rough = span / Math.max(steps, 1);
    const power = 10 ** Math.floor(Math.log10(rough));
    const fraction = rough / power;
    return power * (fraction < 1.5 ? 1 : fraction < 3.5 ? 2 : fraction < 7.5 ? 5 : 10);
  }

  const digitsOf = (step) => Math.min(Math.max(0, -Math.floor(Math.log10(step) + 1e-9)), 9);

  function drawGrid(pen, style, area, view, [low, high]) {
    const bottom = area.top + area.height;
    pen.strokeStyle = style.getPropertyValue("--line");
    pen.fillStyle = style.getPropertyValue("--soft");
    pen.lineWidth = 1;
    pen.font = "11px Roboto, sans-serif";
    pen.beginPath();
    const stepY = stepOf(high - low, area.height / 34);
    const digitsY = digitsOf(stepY);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (let i = Math.ceil(low / stepY - 1e-9); i * stepY <= high; i++) {
      const y = Math.round(bottom - ((i * stepY - low) / (high - low)) * area.height) + 0.5;
      pen.moveTo(area.left, y);
      pen.lineTo(area.left + area.width, y);
      pen.fillText((i * stepY || 0).toFixed(digitsY), area.left - 6, y);
    }
    const stepX = stepOf(view.right - view.left, area.width / 90);
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (let i = Math.ceil(view.left / stepX); i * stepX <= view.right; i++) {
      const x = Math.round(area.left + ((i * stepX - view.left) / (view.right - view.left)) * area.width) + 0.5;
      pen.moveTo(x, area.top);
      pen.lineTo(x, bottom);
      if (i >= 0 && x < area.left + area.width - 14) pen.fillText(`${(i * stepX).toFixed(digitsOf(stepX))} s`, x, bottom + 5);
    }
    pen.stroke();
  }

  // Draws a vertical line at a time, labelled: with the time below it.
  function drawCursor({ pen, area, style }, view, seconds, labelled = true) {
    const x = Math.round(area.left + ((seconds - view.left) / (view.right - view.left)) * area.width) + 0.5;
    pen.strokeStyle = style.getPropertyValue("--ink");
    pen.setLineDash([4, 3]);
    pen.beginPath();
    pen.moveTo(x, area.top);
    pen.lineTo(x, area.top + area.height);
    pen.stroke();
    pen.setLineDash([]);
    if (!labelled) return;
    const text = `${seconds.toFixed(3)} s`;
    const size = pen.measureText(text).width + 8;
    const left = Math.min(Math.max(x - size / 2, area.left), area.left + area.width - size);
    pen.fillStyle = style.getPropertyValue("--ink");
    pen.fillRect(left, area.top + area.height + 2, size, 16);
    pen.fillStyle = style.getPropertyValue("--panel");
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(text, left + size / 2, area.top + area.height + 10);
  }

  return { MARGIN, begin, clipped, color, draw, drawCursor, nearest, rowAt };
})();
