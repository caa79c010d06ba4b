"""How long an editor waits for ``urscript lsp``: until findings are shown after a key, and for its requests.

    python benchmarks/editor.py [FILE] [--keys 60]

Without a file, the program has 4,700 lines in 235 functions. Keys are typed at places spread over the text.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from processes import cpu_s
from table import Table

FUNCTION = """  def part_{0}(x, y=1):
    # a part of the cell
    local total = 0
    q = get_actual_joint_positions()
    i = 0
    while i < 6:
      if q[i] > 1.5 and get_standard_digital_in(i):
        total = total + q[i] * x
      elif q[i] < -1.5:
        total = total - y
      end
      i = i + 1
    end
    target = p[0.1, -0.2 + total, 0.3, 0, 3.14, 0]
    movej(get_inverse_kin(target), a=1.4, v=1.05)
    movel(pose_trans(target, p[0, 0, 0.1, 0, 0, 0]), a=1.2, v=0.25)
    textmsg("total ", total)
    sleep(0.1)
    return total
  end
"""
URI: Final = "file:///tmp/editor_benchmark/{}.script"
KEYS: Final = 60
OPENINGS: Final = 6
_OPENING: Final = "findings after opening"
OF_A_NAME: Final = ("hover", "definition", "documentSymbol", "semanticTokens/full", "foldingRange", "signatureHelp")


def program(functions: int = 235) -> str:
    """A program of 20 lines for each function."""
    calls = "".join(f"  part_{number}({number})\n" for number in range(0, functions, 4))
    return f"def cell():\n{''.join(FUNCTION.format(number) for number in range(functions))}{calls}end\n"


class Editor:
    """A session with the server."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "urscript", "lsp", "--polyscope", "5.22"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._number = self._shown = self._expected = 0
        self.request("initialize", capabilities={})
        self.send("initialized")

    def send(self, method: str, number: int | None = None, **params: Any) -> None:
        message = {"jsonrpc": "2.0", "method": method, "params": params} | ({} if number is None else {"id": number})
        data = json.dumps(message).encode()
        assert self.process.stdin
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(data), data))
        self.process.stdin.flush()

    def read(self) -> dict[str, Any]:
        assert self.process.stdout
        length = 0
        while (line := self.process.stdout.readline()).strip():
            name, _, value = line.partition(b":")
            length = int(value) if name == b"Content-Length" else length
        message: dict[str, Any] = json.loads(self.process.stdout.read(length))
        self._shown += message.get("method") == "textDocument/publishDiagnostics"
        return message

    def request(self, method: str, **params: Any) -> Any:
        self._number += 1
        self.send(method, self._number, **params)
        while (message := self.read()).get("id") != self._number:
            pass
        return message

    def findings(self) -> None:
        """Wait for the findings of the newest text."""
        while self._shown < self._expected:
            self.read()

    def open(self, uri: str, text: str) -> None:
        self._expected += 1
        item = {"uri": uri, "languageId": "urscript", "version": 0, "text": text}
        self.send("textDocument/didOpen", textDocument=item)

    def change(self, uri: str, text: str) -> None:
        self._expected += 1
        self.send("textDocument/didChange", textDocument={"uri": uri, "version": 1}, contentChanges=[{"text": text}])

    def close(self) -> None:
        self.request("shutdown")
        self.send("exit")
        self.process.wait(30)


def measure(text: str = "", keys: int = KEYS) -> Table:
    """One row for each request, and for findings."""
    text = text or program()
    lines = text.split("\n")
    editor = Editor()
    times: dict[str, list[float]] = {}
    costs: dict[str, float] = {}  # CPU time of all requests of a kind [ms]

    def timed(name: str, run: Callable[[], Any]) -> None:
        used, began = cpu_s(editor.process.pid), time.perf_counter()
        run()
        times.setdefault(name, []).append((time.perf_counter() - began) * 1000)
        costs[name] = costs.get(name, 0.0) + (cpu_s(editor.process.pid) - used) * 1000

    for key in range(keys):
        if key % max(1, keys // OPENINGS) == 0:
            uri = URI.format(key)
            editor.open(uri, text)
            timed(_OPENING, editor.findings)
        at = (key * 7919) % (len(lines) - 2) + 1
        changed = [*lines]
        changed[at] += " x"  # a mistake that is only a syntax error where a statement ends
        document = {"uri": uri}
        editor.change(uri, "\n".join(changed))
        if key % 2:
            timed("findings after a key", editor.findings)
        else:
            place = {"line": at, "character": len(changed[at])}
            where = {"textDocument": document, "position": place}
            timed("completion after a key", lambda where=where: editor.request("textDocument/completion", **where))
            editor.findings()
        name = {"line": at, "character": len(lines[at]) - len(lines[at].lstrip()) + 1}
        here = {"textDocument": document, "position": name}
        for method in OF_A_NAME:
            timed(method, lambda method=method, here=here: editor.request(f"textDocument/{method}", **here))
        editor.change(uri, text)
        editor.findings()
    editor.close()
    mean = {name: costs[name] / len(found) for name, found in times.items()}
    rows = [
        [
            name,
            f"{statistics.median(found):.0f} ms",
            f"{max(found):.0f} ms",
            f"{mean[name]:.0f} ms",
            f"{mean[name] / mean[_OPENING]:.3f}",
        ]
        for name, found in sorted(times.items())
    ]
    about = (
        f"`urscript lsp` with a program of {len(lines):,} lines, in which {keys} keys are typed. After opening, the "
        "whole text is read and checked; after a key, what has changed. The last column compares the CPU times."
    )
    return Table("An editor", about, ["request", "median", "longest", "CPU time", "times opening"], rows)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", type=Path)
    parser.add_argument("--keys", type=int, default=KEYS)
    options = parser.parse_args()
    text = options.file.read_text(errors="replace") if options.file else ""
    sys.stdout.write(measure(text, options.keys).markdown())


if __name__ == "__main__":
    main()
