"use strict";
// Six sliders with their numbers: see client/pendant/screens/controllers.py.
(() => {
  const EVERY_MS = 100; // between what the pendant is told: it sends no more often either
  let enabled = false;
  let grid = null;
  let moved = false; // and not told yet
  let waiting = 0; // until it may be told

  const ranges = () => [...grid.querySelectorAll("input[type=range]")];
  const numbers = () => [...grid.querySelectorAll("input[type=number]")];

  // What has been set is told at once, or as soon as it is time again.
  function tell() {
    if (waiting || !moved || !enabled) return;
    moved = false;
    pendant.say({ sliders: ranges().map((range) => Number(range.value)) });
    waiting = setTimeout(() => {
      waiting = 0;
      tell();
    }, EVERY_MS);
  }

  function set(event) {
    const [mine, others] = event.target.type === "range" ? [ranges(), numbers()] : [numbers(), ranges()];
    const i = mine.indexOf(event.target);
    if (i < 0 || !Number.isFinite(event.target.valueAsNumber)) return;
    others[i].value = event.target.type === "range" ? Number(event.target.value).toFixed(2) : event.target.value;
    moved = true;
    tell();
  }

  // [whether the arm follows, angles or null, lowest and highest angles or null], in degrees
  pendant.receivers.sliders = (value, id, element) => {
    if (!element || element.querySelectorAll("input").length < 12) return false;
    if (grid !== element) {
      grid = element;
      grid.addEventListener("input", (event) => event.target.type === "range" && set(event));
      grid.addEventListener("change", (event) => event.target.type === "number" && set(event));
    }
    const [follows, angles, lows, highs] = value;
    enabled = follows;
    [ranges(), numbers()].forEach((inputs) =>
      inputs.forEach((input, i) => {
        input.disabled = !follows;
        if (lows) [input.min, input.max] = [lows[i], highs[i]];
        if (angles) input.value = input.type === "range" ? angles[i] : angles[i].toFixed(2);
      }),
    );
    return true;
  };
})();
