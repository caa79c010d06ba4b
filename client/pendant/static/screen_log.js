"use strict";
// The lines of the log: a change is [whether to clear the list, rows to add], see client/pendant/events.py.
const pendantLog = (() => {
  const clock = new Intl.DateTimeFormat(undefined, {
    hour: "2-digit",
    minute: "2-digit",
    second: "2-digit",
    fractionalSecondDigits: 3,
    hour12: false,
  });

  function row([time, uptime, severity, source, code, text]) {
    const line = document.createElement("div");
    line.className = `log-line ${severity}`;
    pendant.span(line, "log-time", clock.format(time));
    pendant.span(line, "log-uptime", uptime);
    pendant.span(line, "log-severity", "");
    pendant.span(line, "log-source", source);
    pendant.span(line, "log-code", code);
    pendant.span(line, "log-text", text);
    return line;
  }

  function show(id, maxLines) {
    pendant.followers.set(id, (change, box) => {
      const [cleared, rows] = change;
      const atEnd = cleared || box.scrollHeight - box.scrollTop - box.clientHeight < 40;
      if (cleared) box.replaceChildren();
      box.append(...rows.map(row));
      while (box.childElementCount > maxLines) box.firstElementChild.remove();
      if (atEnd) box.scrollTop = box.scrollHeight;
    });
  }

  return { show };
})();
