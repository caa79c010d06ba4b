"use strict";
// What follows the robot on a page: see client/pendant/live.py. Changes are [element id, kind, value].
const pendant = (() => {
  const followers = new Map(); // element id -> function of a value, for kinds that are not plain DOM
  const receivers = {}; // kinds of single screens -> function of a value, an element id and the element, if it is there
  const waiting = new Map(); // changes whose element is not there yet: newest only, but all lines
  const elements = new Map(); // found once, since those of a hidden screen are not in the document
  let socket = null;
  let held = null; // what the button that is held says, and that button
  let holder = null;
  let beat = 0;
  let lost = null; // notes that the connection is gone
  const context = {}; // functions by name: what else is said with every held button

  function element(id) {
    let found = elements.get(id);
    if (!found) {
      found = document.getElementById(`c${id}`);
      if (found) elements.set(id, found);
    }
    return found;
  }

  const appliers = {
    text: (value, target) => void (target.textContent = value),
    state: (value, target) => void (target.dataset.state = value),
    title: (value, target) => void (target.title = value),
    width: (value, target) => void (target.style.width = `${value}%`),
  };

  // Whether it could be shown: the element may not be there yet, or not be ready.
  function apply([id, kind, value]) {
    const target = element(id);
    if (receivers[kind]) return receivers[kind](value, id, target) !== false;
    const show = appliers[kind] || followers.get(id);
    return target && show && show(value, target) !== false;
  }

  function take(changes) {
    for (const change of changes) {
      const key = `${change[0]} ${change[1]}`;
      const queue = (change[1] === "lines" && waiting.get(key)) || [];
      queue.push(change);
      waiting.set(key, queue);
      work(queue, key);
    }
  }

  function work(queue, key) {
    while (queue.length && apply(queue[0])) queue.shift();
    if (!queue.length) waiting.delete(key);
  }

  setInterval(() => waiting.forEach(work), 100);

  // A pendant that was started anew does not know this page, and one that heard nothing of it for a while has forgotten
  // it: NiceGUI then loads it again. What had happened is told by the page that comes.
  function tellLoss(process) {
    const [since, before] = JSON.parse(sessionStorage.getItem("pendant lost") || "[]");
    sessionStorage.removeItem("pendant lost");
    if (since) {
      const seconds = Math.max(1, Math.round((Date.now() - since) / 1000));
      const what = before === process ? "Its connection was lost" : "The pendant has ended and was started anew";
      const text = `${what}: this page was away for ${seconds} s and is loaded anew. What was held here was let go.`;
      sessionStorage.setItem("pendant told", text); // until somebody has read it: the page may be loaded once more
    }
    const message = sessionStorage.getItem("pendant told");
    if (!message) return;
    const read = { label: "OK", color: "dark", handler: () => sessionStorage.removeItem("pendant told") };
    Quasar.Notify.create({ message, type: "warning", position: "top", timeout: 0, actions: [read] });
  }

  // process: of the pendant that has made this page.
  function start(page, process) {
    tellLoss(process);
    let leaving = false;
    addEventListener("pagehide", () => (leaving = true));
    lost = () => {
      if (leaving || sessionStorage.getItem("pendant lost")) return;
      sessionStorage.setItem("pendant lost", JSON.stringify([Date.now(), process]));
    };
    // NiceGUI loads the page again after a time-out too, which ends at a browser's own page while nobody answers.
    window.socket.off("connect_error");
    window.socket.on("connect_error", (error) => error.message === "Implicit handshake failed" && location.reload());
    follow(page);
  }

  function follow(page) {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/live/${page}`);
    socket.onmessage = (event) => take(JSON.parse(event.data));
    socket.onopen = () => sessionStorage.removeItem("pendant lost");
    socket.onclose = () => {
      letGo();
      lost();
      setTimeout(() => follow(page), 500);
    };
  }

  function say(what) {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(what));
  }

  function sayHeld() {
    const more = Object.entries(context).map(([name, read]) => [name, read()]);
    say({ held: { ...held, ...Object.fromEntries(more) } });
  }

  // Buttons with data-hold move the arm as long as they are held; the robot stops when this is not said any more.
  function hold(button) {
    letGo();
    holder = button;
    holder.dataset.held = "";
    held = JSON.parse(button.dataset.hold);
    sayHeld();
    clearInterval(beat);
    beat = setInterval(sayHeld, 100);
  }

  function letGo() {
    if (held === null) return;
    delete holder.dataset.held;
    held = holder = null;
    clearInterval(beat);
    say({ held: null });
  }

  const holdable = (event) => event.target.closest && event.target.closest("[data-hold]");

  // All of these listen in the capture phase of the window, before anybody can stop an event, as Quasar's buttons do
  // with keys.
  function listen(type, does) {
    window.addEventListener(type, does, true);
  }

  listen("pointerdown", (event) => {
    const button = holdable(event);
    if (!button || button.disabled || event.button > 0) return;
    event.preventDefault();
    hold(button);
  });
  listen("keydown", (event) => {
    const button = holdable(event);
    if (!button || button.disabled || (event.key !== " " && event.key !== "Enter")) return;
    event.preventDefault();
    if (!event.repeat) hold(button);
  });
  for (const end of ["pointerup", "pointercancel", "keyup"]) listen(end, letGo);
  listen("blur", (event) => (event.target === window || event.target === holder) && letGo()); // elements' blur passes too
  listen("visibilitychange", () => document.hidden && letGo());
  listen("contextmenu", (event) => {
    if (holdable(event)) event.preventDefault(); // a long touch means hold
    else letGo();
  });

  return { start, followers, receivers, context, say };
})();
