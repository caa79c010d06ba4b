"""A program is damaged key by key while an editor asks: every request is answered, and nothing is logged."""

import json
import random
import subprocess
import sys

import pytest

from tests.budget import examples

PROGRAM = """# a cell
def cell():
  global parts = 0
  def take(at, speed=0.25):
    local above = pose_trans(at, p[0, 0, -0.1, 0, 0, 0])
    movej(get_inverse_kin(above), a=1.4, v=speed)
    if not get_standard_digital_in(0):
      popup("no part\nat all", title="cell", error=True)
    elif parts > 3:
      return False
    else:
      parts = parts + 1
    end
    return True
  end
  thread blink():
    while True:
      set_standard_digital_out(1, parts > 1)
      sleep(0.5)
    end
  end
  h = run blink()
  list = [1, -2, [3, 4]]
  while parts < 10:
    take(p[0.1, 0.2 * parts, 0.3, 0, 3.14, 0], speed=0.5)
    list[0] = list[0] + 1  # count
  end
  kill h
end
"""
PIECES = [
    *("(", ")", "[", "]", '"', "\n", ":", ".", ",", "=", " ", "end", "def f(", "if ", "while True:", "x", "p[", "# "),
    *("\U0001f600", "\r", "run ", "global ", "return ", "$ 1", "0x1F", "&&", "{", "take(", "else:", "\ud800", "\t"),
]
AT_A_PLACE = ("hover", "definition", "completion", "signatureHelp", "prepareRename", "references")
OF_A_TEXT = ("documentSymbol", "foldingRange", "semanticTokens/full", "formatting")
URI = "file:///nowhere/cell.script"


class RawEditor:
    """The protocol without a library."""

    def __init__(self):
        command = [sys.executable, "-m", "urscript", "lsp", "--model", "ur5e"]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        self._number = 0
        self.request("initialize", {"capabilities": {}})

    def send(self, message):
        data = json.dumps({"jsonrpc": "2.0", **message}).encode()
        self.process.stdin.write(b"Content-Length: %d\r\n\r\n%b" % (len(data), data))
        self.process.stdin.flush()

    def request(self, method, params):
        self._number += 1
        self.send({"id": self._number, "method": method, "params": params})
        while (message := self._read()).get("id") != self._number:
            pass
        return message

    def _read(self):
        length = 0
        while line := self.process.stdout.readline().strip():
            name, _, value = line.partition(b":")
            length = int(value) if name == b"Content-Length" else length
        return json.loads(self.process.stdout.read(length))

    def close(self):
        self.request("shutdown", None)
        self.send({"method": "exit"})
        _, logged = self.process.communicate(timeout=60)
        assert self.process.returncode == 0
        return logged.decode()


@pytest.fixture
def editor():
    made = RawEditor()
    yield made
    made.process.kill()
    made.process.communicate()


def damage(text, chosen):
    at = chosen.randrange(len(text) + 1)
    match chosen.randrange(3):
        case 0:
            return text[:at] + chosen.choice(PIECES) + text[at:]
        case 1:
            return text[:at] + text[at + chosen.randrange(1, 9) :]
        case _:
            there = chosen.randrange(len(text) + 1)
            return text[:at] + text[there : there + 12] + text[at:]


def test_a_request_that_is_none_has_an_answer(editor):
    answer = editor.request("textDocument/hover", {"textDocument": 1})
    assert answer["error"]["message"] == "Invalid Params"
    assert "Invalid Params" in editor.close()


@pytest.mark.parametrize("count", [200, pytest.param(2000, marks=pytest.mark.long)])
def test_every_request_is_answered(editor, count):
    chosen = random.Random(7)
    document = {"uri": URI}
    opened = {**document, "languageId": "urscript", "version": 0, "text": PROGRAM}
    editor.send({"method": "textDocument/didOpen", "params": {"textDocument": opened}})
    text, wrong = PROGRAM, []
    for number in range(examples(count)):
        text = damage(PROGRAM if number % 8 == 0 else text, chosen)
        change = {"textDocument": {**document, "version": number + 1}, "contentChanges": [{"text": text}]}
        editor.send({"method": "textDocument/didChange", "params": change})
        place = {"line": chosen.randrange(32), "character": chosen.randrange(60)}
        method = chosen.choice(AT_A_PLACE if number % 2 else OF_A_TEXT)
        more = {
            "references": {"context": {"includeDeclaration": True}},
            "formatting": {"options": {"tabSize": 2, "insertSpaces": True}},
        }
        params = {"textDocument": document, "position": place, **more.get(method, {})}
        answer = editor.request(f"textDocument/{method}", params)
        if "error" in answer:
            wrong.append((method, answer["error"]["message"], text))
    assert not wrong
    assert editor.close() == ""
