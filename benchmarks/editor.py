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
from pathlib import Path
from typing import Any

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
URI = "file:///tmp/editor_benchmark/cell.script"


def program(functions: int = 235) -> str:
    """A program of 20 lines for each function."""
    calls = "".join(f"  part_{number}({number})\n" for number in range(0, functions, 4))
    return f"def cell():\n{''.join(FUNCTION.format(number) for number in range(functions))}{calls}end\n"


class Editor:
    """A session with the server."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "urscript", "lsp", "--polyscope", "5.22"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._number = 0
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
        return message

    def request(self, method: str, **params: Any) -> Any:
        self._number += 1
        self.send(method, self._number, **params)
        while (message := self.read()).get("id") != self._number:
            pass
        return message

    def findings(self) -> Any:
        while (message := self.read()).get("method") != "textDocument/publishDiagnostics":
            pass
        return message["params"]["diagnostics"]

    def change(self, text: str, version: int) -> None:
        document = {"uri": URI, "version": version}
        self.send("textDocument/didChange", textDocument=document, contentChanges=[{"text": text}])

    def close(self) -> None:
        self.request("shutdown")
        self.send("exit")
        self.process.wait(30)


def main() -> None:
    """Print a table: the middle and the longest time of each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", nargs="?", type=Path)
    parser.add_argument("--keys", type=int, default=60)
    options = parser.parse_args()
    text = options.file.read_text(errors="replace") if options.file else program()
    lines = text.split("\n")
    editor = Editor()
    times: dict[str, list[float]] = {}

    def timed(name: str, run: Any) -> Any:
        began = time.perf_counter()
        result = run()
        times.setdefault(name, []).append((time.perf_counter() - began) * 1000)
        return result

    item = {"uri": URI, "languageId": "urscript", "version": 0, "text": text}
    editor.send("textDocument/didOpen", textDocument=item)
    timed("findings after opening", editor.findings)
    for key in range(options.keys):
        at = (key * 7919) % (len(lines) - 2) + 1
        changed = [*lines]
        changed[at] += " x"  # a mistake that is only a syntax error where a statement ends
        editor.change("\n".join(changed), 2 * key + 1)
        place = {"line": at, "character": len(changed[at])}
        where = {"textDocument": {"uri": URI}, "position": place}
        if key % 2:
            timed("findings after a key", editor.findings)
            time.sleep(0.1)
        else:
            timed("completion after a key", lambda where=where: editor.request("textDocument/completion", **where))
        name = {"line": at, "character": len(lines[at]) - len(lines[at].lstrip()) + 1}
        here = {"textDocument": {"uri": URI}, "position": name}
        for method in ("hover", "definition", "documentSymbol", "semanticTokens/full", "foldingRange", "signatureHelp"):
            timed(method, lambda method=method, here=here: editor.request(f"textDocument/{method}", **here))
        editor.change(text, 2 * key + 2)
        time.sleep(1.2)
        editor.request("textDocument/hover", **here)
    editor.close()
    print(f"{len(lines)} lines, {options.keys} keys; milliseconds")
    print(f"{'':<26}{'p50':>8}{'max':>8}{'n':>6}")
    for name, found in times.items():
        print(f"{name:<26}{statistics.median(found):8.1f}{max(found):8.1f}{len(found):6}")


if __name__ == "__main__":
    main()
