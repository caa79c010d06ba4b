"use strict";
// Run: variables, which flash when they change, and the program, with the executing line marked.
const pendantRun = (() => {
  const { span } = pendant;

  // A change is [names of a new program or null, {index: [kind, value]}]: see client/pendant/variables.py.
  function variables(id) {
    let rows = [];
    pendant.followers.set(id, (change, box) => {
      const [names, values] = change;
      if (names) rows = names.map((name) => variable(name));
      if (names) box.replaceChildren(...rows.map((row) => row.line));
      for (const [index, [kind, value]] of Object.entries(values)) {
        const row = rows[index];
        if (!row) continue;
        row.kind.textContent = kind;
        row.value.textContent = value;
        row.value.title = value;
        if (!names) flash(row.line);
      }
    });
  }

  function variable(name) {
    const line = document.createElement("div");
    line.className = "variable";
    const shown = span(line, "variable-name", name);
    shown.title = name;
    return { line, kind: span(line, "variable-kind", ""), value: span(line, "variable-value", "") };
  }

  function flash(line) {
    line.getAnimations().forEach((animation) => animation.cancel());
    line.animate([{ backgroundColor: "rgba(86, 160, 211, .45)" }, { backgroundColor: "transparent" }], 900);
  }

  // The content of a box is {text} or {tree: [[number, depth, text, suppressed], ...]}. Marks are the numbers of lines
  // or nodes.
  function program(boxId, marksId) {
    let lines = new Map();
    let marked = [];
    let box = null;

    function mark() {
      document.querySelectorAll(".program-line.current").forEach((line) => line.classList.remove("current"));
      const found = marked.map((number) => lines.get(number)).filter((line) => line);
      found.forEach((line) => line.classList.add("current"));
      if (found.length && box) reveal(found[0]);
    }

    function reveal(line) {
      const top = line.offsetTop - box.offsetTop;
      if (top < box.scrollTop || top + line.offsetHeight > box.scrollTop + box.clientHeight)
        box.scrollTop = top - box.clientHeight / 2;
    }

    pendant.followers.set(boxId, (content, target) => {
      box = target;
      lines = new Map();
      const made = content.tree ? content.tree.map(node) : script(content.text).map(scriptLine);
      made.forEach(([number, line]) => lines.set(number, line));
      box.replaceChildren(...made.map(([, line]) => line));
      box.classList.toggle("empty", made.length === 0);
      mark();
    });
    pendant.followers.set(marksId, (numbers) => {
      marked = numbers;
      mark();
    });
  }

  function script(text) {
    const found = text.split("\n");
    if (found[found.length - 1] === "") found.pop();
    return found;
  }

  function scriptLine(text, index) {
    const line = document.createElement("div");
    line.className = "program-line";
    line.dataset.line = index + 1;
    span(line, "program-number", index + 1);
    span(line, "program-code", text);
    return [index + 1, line];
  }

  function node([number, depth, text, suppressed]) {
    const line = document.createElement("div");
    line.className = `program-line program-node${suppressed ? " suppressed" : ""}`;
    line.dataset.line = number;
    span(line, "program-number", number);
    span(line, "program-name", text).style.paddingLeft = `${Math.max(0, depth) * 22}px`;
    return [number, line];
  }

  // Gives the editor the dark or light theme of the page.
  function editor(id) {
    let made = null;
    function adapt() {
      const found = getElement(id);
      const theme = document.body.classList.contains("body--dark") ? "githubDark" : "githubLight";
      if (found && found.editor && (found.editor !== made || found.shownTheme !== theme)) {
        made = found.editor;
        found.shownTheme = theme;
        found.setTheme(theme);
      }
    }
    new MutationObserver(adapt).observe(document.body, { attributes: true, attributeFilter: ["class"] });
    const wait = setInterval(() => {
      adapt();
      if (made) clearInterval(wait);
    }, 200);
  }

  // Sets the name of an editor for screen readers, which NiceGUI's element cannot do.
  function name(id, text) {
    const content = document.querySelector(`#c${id} .cm-content`);
    if (content) content.setAttribute("aria-label", text);
    else setTimeout(() => name(id, text), 200);
  }

  return { name, variables, program, editor };
})();
