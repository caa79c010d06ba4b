"use strict";
// Program: the tree of nodes, used by mouse, touch and keyboard. The user's actions are sent as the event "treecommand".
const pendantProgram = (() => {
  // A row is [id, number, depth, icon, text, marks, problem]. The marks are words: undefined, problem, suppressed,
  // breakpoint.
  const ID = 0, NUMBER = 1, DEPTH = 2, ICON = 3, TEXT = 4, MARKS = 5, PROBLEM = 6;
  const DRAG_PX = 6; // a shorter movement counts as a click

  const { span } = pendant;

  // Keys for the whole screen work everywhere except in a field; keys for a node work only in the tree.
  const COMMANDS = {
    "ctrl+z": "undo", "ctrl+y": "redo", "ctrl+shift+z": "redo", "ctrl+s": "save",
  };
  const NODE_COMMANDS = {
    "ctrl+x": "cut", "ctrl+c": "copy", "ctrl+v": "paste", delete: "delete", backspace: "delete",
    "alt+arrowup": "up", "alt+arrowdown": "down", "ctrl+e": "suppress", f9: "breakpoint", enter: "edit",
  };

  function chord(event) {
    const words = [];
    if (event.ctrlKey || event.metaKey) words.push("ctrl");
    if (event.altKey) words.push("alt");
    if (event.shiftKey) words.push("shift");
    return [...words, event.key.toLowerCase()].join("+");
  }

  const isEditing = (target) => target.closest && target.closest("input, textarea, [contenteditable=true], .q-dialog");

  // boxId: the tree; marksId: numbers of the nodes that are executing; chosenId: the selected node; formId: its fields.
  function tree(boxId, marksId, chosenId, formId) {
    const closed = new Set(); // ids of nodes whose children are hidden
    let rows = [];
    let order = new Map(); // id -> index of its row
    let items = new Map(); // id -> element of a row in view
    let drawn = new Map(); // id -> [content of the row, its element]; kept because trees may have thousands of rows
    let first = null; // the row that has the tab stop while none is selected
    let marked = new Set(); // ids of rows that are selected or executing
    let running = new Set();
    let chosen = null;
    let box = null;

    const send = (command, id) => box.dispatchEvent(new CustomEvent("treecommand", { detail: [command, id] }));
    const fields = () => document.getElementById(`c${formId}`);
    const hasChildren = (index) => index + 1 < rows.length && rows[index + 1][DEPTH] > rows[index][DEPTH];
    const indexOf = (id) => order.get(id) ?? -1;

    function draw() {
      if (!box) return;
      if (indexOf(chosen) < 0) chosen = fields()?.dataset.node ?? chosen; // the selected node was deleted
      const focused = box.contains(document.activeElement);
      items = new Map();
      const before = drawn;
      drawn = new Map();
      let hidden = Infinity; // deeper rows are hidden
      rows.forEach((row, index) => {
        if (row[DEPTH] > hidden) return;
        const opens = hasChildren(index);
        hidden = closed.has(row[ID]) && opens ? row[DEPTH] : Infinity;
        const made = JSON.stringify([row, opens, closed.has(row[ID])]);
        const [drawnContent, item] = before.get(row[ID]) ?? [];
        drawn.set(row[ID], drawnContent === made ? [drawnContent, item] : [made, line(row, opens)]);
        items.set(row[ID], drawn.get(row[ID])[1]);
      });
      for (const [id, item] of [...before].map(([id, [, item]]) => [id, item])) if (items.get(id) !== item) item.remove();
      let at = box.firstChild; // rows in place stay: this preserves the scroll position and focus
      for (const item of items.values()) {
        if (item === at) at = at.nextSibling;
        else box.insertBefore(item, at);
      }
      mark(focused);
    }

    function line(row, opens) {
      const item = document.createElement("div");
      const marks = row[MARKS].split(" ").filter((word) => word);
      item.className = ["program-row", ...marks.map((word) => `is-${word}`)].join(" ");
      item.setAttribute("role", "treeitem");
      item.setAttribute("aria-level", row[DEPTH] + 1);
      item.setAttribute("aria-selected", "false");
      item.tabIndex = -1;
      item.dataset.node = row[ID];
      item.dataset.number = row[NUMBER];
      if (opens) item.setAttribute("aria-expanded", String(!closed.has(row[ID])));
      const words = [`${row[NUMBER]} ${row[TEXT]}`, ...marks, ...(row[PROBLEM] ? [row[PROBLEM]] : [])];
      item.setAttribute("aria-label", words.join(", "));
      if (row[PROBLEM]) item.title = row[PROBLEM];
      span(item, "program-break", "").setAttribute("aria-hidden", "true");
      span(item, "program-row-number", row[NUMBER]);
      const indented = span(item, "program-row-name", "");
      indented.style.paddingLeft = `${row[DEPTH] * 20}px`;
      const fold = span(indented, "program-fold material-icons", opens ? (closed.has(row[ID]) ? "chevron_right" : "expand_more") : "");
      fold.setAttribute("aria-hidden", "true");
      span(indented, "program-icon material-icons", row[ICON]).setAttribute("aria-hidden", "true");
      span(indented, "program-row-text", row[TEXT]);
      if (row[PROBLEM]) span(indented, "program-row-problem", row[PROBLEM]);
      return item;
    }

    function mark(focus) {
      const before = marked;
      marked = new Set(rows.filter((row) => running.has(row[NUMBER])).map((row) => row[ID]));
      const executing = new Set(marked);
      if (chosen) marked.add(chosen);
      if (first) marked.add(first.dataset.node);
      for (const id of new Set([...before, ...marked])) {
        const item = items.get(id);
        if (!item) continue;
        item.setAttribute("aria-selected", String(id === chosen));
        item.tabIndex = id === chosen ? 0 : -1;
        item.classList.toggle("is-running", executing.has(id));
        if (executing.has(id)) item.setAttribute("aria-current", "step");
        else item.removeAttribute("aria-current");
      }
      const item = items.get(chosen);
      if (item && focus) item.focus();
      first = !item && items.size ? items.values().next().value : null; // the tree needs a tab stop
      if (first) first.tabIndex = 0;
      disableOldFields();
    }

    // The fields are inert until they are those of the selected node, so that nothing is typed into the previous ones.
    function disableOldFields() {
      const form = fields();
      if (form) form.inert = form.dataset.node !== chosen;
    }

    function reveal(item) {
      if (item) item.scrollIntoView({ block: "nearest" });
    }

    function choose(id) {
      if (id === undefined || id === null) return;
      chosen = id;
      mark(true);
      reveal(items.get(id));
      send("select", id);
    }

    function fold(id, close) {
      if (close) closed.add(id);
      else closed.delete(id);
      draw();
    }

    function navigate(event) {
      const shown = [...items.keys()];
      const at = Math.max(0, shown.indexOf(chosen));
      const index = indexOf(chosen);
      const key = event.key;
      if (key === "ArrowDown") choose(shown[Math.min(at + 1, shown.length - 1)]);
      else if (key === "ArrowUp") choose(shown[Math.max(at - 1, 0)]);
      else if (key === "Home") choose(shown[0]);
      else if (key === "End") choose(shown[shown.length - 1]);
      else if (key === "ArrowRight" && index >= 0 && hasChildren(index))
        closed.has(chosen) ? fold(chosen, false) : choose(rows[index + 1][ID]);
      else if (key === "ArrowLeft" && index >= 0) {
        if (hasChildren(index) && !closed.has(chosen)) fold(chosen, true);
        else choose(rows.slice(0, index).reverse().find((row) => row[DEPTH] < rows[index][DEPTH])?.[ID]);
      } else return false;
      return true;
    }

    function key(event) {
      const word = chord(event);
      const plain = !event.ctrlKey && !event.metaKey && !event.altKey;
      const done = (plain && navigate(event)) || (NODE_COMMANDS[word] && (send(NODE_COMMANDS[word], chosen), true));
      if (!done) return;
      event.preventDefault();
      event.stopPropagation();
    }

    function click(event) {
      const item = event.target.closest(".program-row");
      if (!item) return;
      const id = item.dataset.node;
      if (event.target.closest(".program-fold") && item.hasAttribute("aria-expanded")) fold(id, !closed.has(id));
      else if (event.target.closest(".program-break")) send("breakpoint", id);
      choose(id);
    }

    // A mouse drags a node anywhere in its row; touch drags it at its icon, because elsewhere it scrolls the tree.
    let drag = null; // {id, x, y, begun, at: [id of a node, "before", "onto" or "after"]}

    function press(event) {
      const item = event.target.closest(".program-row");
      if (!item || event.button > 0) return;
      if (event.pointerType === "touch" && !event.target.closest(".program-icon")) return;
      drag = { id: item.dataset.node, x: event.clientX, y: event.clientY, begun: false, at: null };
    }

    function dragOver(event) {
      if (!drag) return;
      if (!drag.begun && Math.hypot(event.clientX - drag.x, event.clientY - drag.y) < DRAG_PX) return;
      if (!drag.begun) {
        drag.begun = true;
        box.setPointerCapture(event.pointerId);
        box.classList.add("is-dragging");
      }
      showDrop(null);
      const over = document.elementFromPoint(event.clientX, event.clientY)?.closest(".program-row");
      if (!over || over.dataset.node === drag.id) return;
      const { top, height } = over.getBoundingClientRect();
      const share = (event.clientY - top) / height;
      showDrop([over.dataset.node, share < 0.3 ? "before" : share > 0.7 ? "after" : "onto"]);
      reveal(over);
    }

    function showDrop(at) {
      if (drag.at) items.get(drag.at[0])?.removeAttribute("data-drop");
      drag.at = at;
      if (at) items.get(at[0])?.setAttribute("data-drop", at[1]);
    }

    function release(accept) {
      if (!drag) return;
      const { id, at, begun } = drag;
      if (begun) showDrop(null);
      box.classList.remove("is-dragging");
      drag = null;
      if (begun && at && accept) pendant.send({ drop: [id, ...at] });
    }

    pendant.followers.set(boxId, (content, target) => {
      if (box !== target) {
        box = target;
        box.addEventListener("pointerdown", press);
        box.addEventListener("pointermove", dragOver);
        box.addEventListener("pointerup", () => release(true));
        box.addEventListener("pointercancel", () => release(false));
        window.addEventListener("keydown", (event) => event.key === "Escape" && release(false));
        box.addEventListener("keydown", key);
        box.addEventListener("click", click);
        new MutationObserver(disableOldFields).observe(fields(), { attributeFilter: ["data-node"] });
      }
      rows = content;
      order = new Map(rows.map((row, index) => [row[ID], index]));
      draw();
    });
    pendant.followers.set(marksId, (numbers) => {
      const before = running;
      running = new Set(numbers);
      mark(false);
      const started = rows.find((row) => running.has(row[NUMBER]) && !before.has(row[NUMBER]));
      if (started) reveal(items.get(started[ID]));
    });
    pendant.followers.set(chosenId, (id) => {
      chosen = id;
      for (let index = indexOf(id), depth = Infinity; index >= 0; index--) {
        if (rows[index][DEPTH] < depth) closed.delete(depth === Infinity ? null : rows[index][ID]);
        depth = Math.min(depth, rows[index][DEPTH]);
      }
      draw();
      reveal(items.get(id));
    });
    window.addEventListener("keydown", (event) => {
      if (!box || !box.offsetParent || isEditing(event.target) || !COMMANDS[chord(event)]) return;
      event.preventDefault();
      send(COMMANDS[chord(event)], chosen);
    });
  }

  // Moves the focus to the first field of the form, after Enter was pressed at a node.
  const edit = (formId) => document.getElementById(`c${formId}`)?.querySelector("input, textarea, button")?.focus();

  return { tree, edit };
})();
