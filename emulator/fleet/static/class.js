"use strict";
// The page of a class: see emulator/fleet/class_server.py. Shows the robots twice a second, and sends the teacher's commands.
(() => {
  const PERIOD_MS = 500;
  const find = (id) => document.getElementById(id);
  let teacher = false;
  let count = 0;

  // Setting what is already there would let the browser draw everything again.
  function set(element, name, value) {
    if (element.getAttribute(name) !== String(value)) element.setAttribute(name, value);
  }

  async function request(path, content) {
    const options = content && {
      method: "POST", body: JSON.stringify(content), headers: { "Content-Type": "application/json" },
    };
    const response = await fetch(path, options);
    const answer = await response.json();
    if (!response.ok && response.status !== 401) throw new Error(answer.error);
    return { ...answer, known: response.status !== 401 };
  }

  async function command(action, robots, name = "") {
    const whom = robots.length > 1 ? "all robots" : find("robots").children[robots[0] - 1].dataset.name;
    if (action === "reset" && !confirm(`Reset ${whom}? Programs stop, and arms return to where they started.`)) return;
    try {
      const { failed } = await request("/robots", { action, robots, name });
      find("message").textContent = Object.entries(failed).map(([robot, why]) => `${robot}: ${why}`).join(" ");
    } catch (error) {
      find("message").textContent = error.message;
    }
  }

  function create(number) {
    const item = find("robot").content.cloneNode(true).firstElementChild;
    const link = item.querySelector("a");
    link.href = `/robot/${number}`;
    link.textContent = `${location.host}/robot/${number}`;
    item.dataset.testid = `robot-${number}`;
    for (const button of item.querySelectorAll("button"))
      button.addEventListener("click", () => command(button.dataset.action, [number]));
    item.querySelector("input").addEventListener("change", (event) => command("name", [number], event.target.value));
    return item;
  }

  function show(item, robot) {
    const known = "mode" in robot;
    const values = {
      model: `${robot.model}, ${robot.host}`,
      mode: !known ? "does not answer" : robot.safety === "NORMAL" ? robot.mode : `${robot.mode}, ${robot.safety}`,
      program: known ? [robot.runtime, robot.program].filter(Boolean).join(": ") : "–",
      clients: (robot.clients || []).join("\n") || "nobody",
    };
    for (const [name, value] of Object.entries(values)) {
      const place = item.querySelector(`[data-value="${name}"]`);
      const text = value.replaceAll("_", " ");
      if (place.textContent !== text) place.textContent = text;
    }
    item.dataset.name = robot.name;
    item.dataset.mode = known ? robot.mode : "unknown";
    const title = item.querySelector("h2");
    if (title.textContent !== robot.name) title.textContent = robot.name;
    title.hidden = teacher;
    item.querySelector("label").hidden = item.querySelector("div").hidden = !teacher;
    set(item.querySelector("a"), "aria-label", `Open the pendant of ${robot.name}`);
    set(item.querySelector("svg"), "aria-label", `The arm of ${robot.name}`);
    for (const button of item.querySelectorAll("button")) set(button, "aria-label", `${button.textContent} ${robot.name}`);
    const input = item.querySelector("input");
    if (document.activeElement !== input && input.value !== robot.name) input.value = robot.name;
    const lines = item.querySelectorAll("line");
    (robot.arm || []).forEach(([x1, y1, x2, y2, width], i) => {
      for (const [name, value] of Object.entries({ x1, y1, x2, y2, "stroke-width": width })) set(lines[i], name, value);
    });
  }

  async function update() {
    const { known, role, robots } = await request("/robots");
    find("login").hidden = known;
    teacher = role === "teacher";
    find("all").hidden = !teacher;
    find("robots").hidden = !known;
    if (!known) return;
    count = robots.length;
    const list = find("robots");
    while (list.children.length < count) list.append(create(list.children.length + 1));
    robots.forEach((robot, i) => show(list.children[i], robot));
  }

  async function keepUpdating() {
    try {
      if (!document.hidden) await update();
      if (find("message").dataset.lost) find("message").textContent = "";
      delete find("message").dataset.lost;
    } catch {
      find("message").textContent = "The fleet does not answer: this page shows the last state.";
      find("message").dataset.lost = "yes";
    }
    setTimeout(keepUpdating, PERIOD_MS);
  }

  find("login").addEventListener("submit", async (event) => {
    event.preventDefault();
    const { known } = await request("/login", { password: find("password").value });
    find("message").textContent = known ? "" : "This password is wrong.";
    if (known && location.hash.startsWith("#/robot/")) location.href = location.hash.slice(1);
    else if (known) await update();
  });
  for (const button of find("all").children)
    button.addEventListener("click", () => command(button.dataset.action, Array.from({ length: count }, (_, i) => i + 1)));
  keepUpdating();
})();
