"use strict";
// Six sliders with number fields: see client/pendant/screens/controllers.py.
(() => {
  const PERIOD_MS = 100; // between messages to the pendant, which does not send trajectories more often either
  let enabled = false;
  let grid = null;
  let moved = false; // a value has changed and has not been sent yet
  let waiting = 0; // timer until the next message may be sent

  const ranges = () => [...grid.querySelectorAll("input[type=range]")];
  const numbers = () => [...grid.querySelectorAll("input[type=number]")];

  // Sends the values immediately, or when the time since the last message is over.
  function sendTargets() {
    if (waiting || !moved || !enabled) return;
    moved = false;
    pendant.send({ sliders: ranges().map((range) => Number(range.value)) });
    waiting = setTimeout(() => {
      waiting = 0;
      sendTargets();
    }, PERIOD_MS);
  }

  function onInput(event) {
    const [changed, counterparts] = event.target.type === "range" ? [ranges(), numbers()] : [numbers(), ranges()];
    const i = changed.indexOf(event.target);
    if (i < 0 || !Number.isFinite(event.target.valueAsNumber)) return;
    counterparts[i].value = event.target.type === "range" ? Number(event.target.value).toFixed(2) : event.target.value;
    moved = true;
    sendTargets();
  }

  // [whether the arm follows, angles or null, lowest angles or null, highest angles or null], in degrees
  pendant.receivers.sliders = (value, id, element) => {
    if (!element || element.querySelectorAll("input").length < 12) return false;
    if (grid !== element) {
      grid = element;
      grid.addEventListener("input", (event) => event.target.type === "range" && onInput(event));
      grid.addEventListener("change", (event) => event.target.type === "number" && onInput(event));
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
