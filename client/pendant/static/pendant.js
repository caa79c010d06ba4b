"use strict";
// Applies live changes to a page and reports held buttons: see client/pendant/live.py. A change is
// [element id, kind, value].
const pendant = (() => {
  const followers = new Map(); // element id -> function of a value, for kinds that are not plain DOM
  const receivers = {}; // kind, used by one screen -> function of a value, an element id, and the element if it exists
  const pending = new Map(); // changes whose element does not exist yet: only the newest, but all of kind "lines"
  const elements = new Map(); // a cache, because the elements of a hidden screen are not in the document
  let socket = null;
  let held = null; // the message of the held button; `holder` is the button
  let holder = null;
  let heartbeat = 0;
  let recordLoss = null; // records when the connection was lost
  let receivedAt = null; // time of the last message [ms]: the pendant sends one at least every 0.4 s
  const context = {}; // functions by name, whose values are sent with every message of a held button

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

  // Returns false if the change cannot be applied yet: the element may not exist, or may not be ready.
  function apply([id, kind, value]) {
    const target = element(id);
    if (receivers[kind]) return receivers[kind](value, id, target) !== false;
    const show = appliers[kind] || followers.get(id);
    return target && show && show(value, target) !== false;
  }

  function receive(changes) {
    receivedAt = performance.now();
    if ("old" in document.body.dataset) showAge();
    for (const change of changes) {
      const key = `${change[0]} ${change[1]}`;
      const queue = (change[1] === "lines" && pending.get(key)) || [];
      queue.push(change);
      pending.set(key, queue);
      drain(queue, key);
    }
  }

  function drain(queue, key) {
    while (queue.length && apply(queue[0])) queue.shift();
    if (!queue.length) pending.delete(key);
  }

  setInterval(() => pending.forEach(drain), 100);

  // Values that the pendant no longer renews are grey, and a line says how old they are.
  function showAge() {
    const seconds = receivedAt === null ? 0 : Math.floor((performance.now() - receivedAt) / 1000);
    const banner = document.querySelector(".old");
    if (!banner) return;
    document.body.toggleAttribute("data-old", seconds > 0);
    banner.dataset.state = seconds > 0 ? "lost" : "ok";
    banner.lastElementChild.textContent = `The pendant does not answer: these values are ${seconds} s old.`;
  }

  setInterval(showAge, 250);

  // After a restart the pendant does not know this page, and after some time without messages it has discarded it.
  // NiceGUI then reloads the page, and the reloaded page tells the user what happened.
  function notifyOfReload(process) {
    const [since, before] = JSON.parse(sessionStorage.getItem("pendant lost") || "[]");
    sessionStorage.removeItem("pendant lost");
    if (since) {
      const seconds = Math.max(1, Math.round((Date.now() - since) / 1000));
      const reason = before === process ? "Connection to the pendant lost" : "The pendant was restarted";
      const text = `${reason}: this page was disconnected for ${seconds} s and has been reloaded. Held buttons were released.`;
      sessionStorage.setItem("pendant reload notice", text); // until it is confirmed: the page may be reloaded again before that
    }
    const message = sessionStorage.getItem("pendant reload notice");
    if (!message) return;
    const confirm = { label: "OK", color: "dark", handler: () => sessionStorage.removeItem("pendant reload notice") };
    Quasar.Notify.create({ message, type: "warning", position: "top", timeout: 0, actions: [confirm] });
  }

  // process: identifies the pendant process that created this page.
  function start(page, process) {
    notifyOfReload(process);
    let leaving = false;
    addEventListener("pagehide", () => (leaving = true));
    recordLoss = () => {
      if (leaving || sessionStorage.getItem("pendant lost")) return;
      sessionStorage.setItem("pendant lost", JSON.stringify([Date.now(), process]));
    };
    // NiceGUI also reloads the page after a time-out, which would show the browser's error page if nothing answers.
    window.socket.off("connect_error");
    window.socket.on("connect_error", (error) => error.message === "Implicit handshake failed" && location.reload());
    follow(page);
  }

  function follow(page) {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    socket = new WebSocket(`${scheme}://${location.host}/live/${page}`);
    socket.onmessage = (event) => receive(JSON.parse(event.data));
    socket.onopen = () => sessionStorage.removeItem("pendant lost");
    socket.onclose = () => {
      release();
      recordLoss();
      setTimeout(() => follow(page), 500);
    };
  }

  function send(message) {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
  }

  function sendHeld() {
    const values = Object.entries(context).map(([name, read]) => [name, read()]);
    send({ held: { ...held, ...Object.fromEntries(values) } });
  }

  // Buttons with data-hold move the arm while they are held; the robot stops when these messages stop.
  function hold(button) {
    release();
    holder = button;
    holder.dataset.held = "";
    held = JSON.parse(button.dataset.hold);
    sendHeld();
    clearInterval(heartbeat);
    heartbeat = setInterval(sendHeld, 100);
  }

  function release() {
    if (held === null) return;
    delete holder.dataset.held;
    held = holder = null;
    clearInterval(heartbeat);
    send({ held: null });
  }

  // Adds a <span> to an element; returns it.
  function span(parent, kind, text) {
    const made = document.createElement("span");
    made.className = kind;
    made.textContent = text;
    parent.appendChild(made);
    return made;
  }

  const holdable = (event) => event.target.closest && event.target.closest("[data-hold]");

  // All of these listen in the capture phase of the window, before another listener can stop the event, as Quasar's
  // buttons do with keys.
  function listen(type, handler) {
    window.addEventListener(type, handler, true);
  }

  // A pendant that does not answer would receive a click when it answers again: too late.
  const control = ":is(.screens, .frame, .q-dialog) :is(button, [role=tab], .q-toggle, .q-slider, .q-checkbox, .q-item)";
  for (const type of ["click", "pointerdown", "mousedown", "touchstart", "keydown"])
    listen(type, (event) => {
      const used = type !== "keydown" || event.key === " " || event.key === "Enter";
      if (!("old" in document.body.dataset) || !used || !event.target.closest?.(control)) return;
      event.preventDefault();
      event.stopImmediatePropagation();
    });
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
  for (const end of ["pointerup", "pointercancel", "keyup"]) listen(end, release);
  listen("blur", (event) => (event.target === window || event.target === holder) && release()); // also gets blur of elements
  listen("visibilitychange", () => document.hidden && release());
  listen("contextmenu", (event) => {
    if (holdable(event)) event.preventDefault(); // a long touch holds the button, and opens no menu
    else release();
  });

  return { start, followers, receivers, context, send, span };
})();
