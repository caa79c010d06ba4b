"use strict";
// Rows of lamps and tables of registers: see client/pendant/screens/io_*.py.
(() => {
  function label(cell, text) {
    const name = cell.lastElementChild;
    if (name.textContent !== text) name.textContent = text;
  }

  // Whether the element exists, with all its content.
  function ready(element) {
    return element && element.lastElementChild?.lastElementChild;
  }

  // One digit per lamp; [first, digits] also numbers the lamps, and null hides them.
  pendant.receivers.bits = (value, id, row) => {
    if (!ready(row)) return false;
    row.hidden = value === null;
    if (value === null) return true;
    const [first, levels] = typeof value === "string" ? [null, value] : value;
    for (let i = 0; i < row.children.length; i++) {
      const state = levels[i] === "1" ? "on" : levels[i] === "0" ? "off" : "";
      if (row.children[i].dataset.state !== state) row.children[i].dataset.state = state;
      row.children[i].disabled = state === ""; // the robot does not answer
      if (first !== null) label(row.children[i], String(first + i));
    }
    return true;
  };

  // [first, texts]: the cells, numbered from `first` on; null hides the table.
  pendant.receivers.cells = (value, id, table) => {
    if (!ready(table)) return false;
    table.hidden = value === null;
    if (value === null) return true;
    const [first, texts] = value;
    for (let i = 0; i < table.children.length; i++) {
      const shown = table.children[i].firstElementChild;
      if (shown.textContent !== texts[i]) shown.textContent = texts[i];
      label(table.children[i], String(first + i));
    }
    return true;
  };
})();
