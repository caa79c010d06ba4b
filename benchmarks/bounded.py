"""Whether work that others cause can hold up a robot: ``make bounded``.

``bounded.py [--count N] [--json FILE] [CASE ...]``. Each case sends one request, again and again, to an emulator of a
UR5e, or gives it a hostile file. A client at 500 Hz and a bare loop run at the same time. The exit status is 1 if robot
time runs at less than 0.99 of the pace of the bare loop, or if the client receives nothing for more than 50 ms longer
than the bare loop was held up.
"""

import argparse
import gzip
import json
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec
from chaos import Witness, emulator

from emulator.commands.dashboard import COMMANDS
from emulator.control.control import LiveControl
from emulator.control.verbs import Verb, verbs_of
from emulator.robotapi.endpoints import OPERATIONS
from urproto.robotapi import BASE, PUT_PROGRAM_STATE, PUT_STATE
from urproto.testing.process import EmulatorProcess

COUNT = 1000
PERIOD_S = 0.002
LEAST_PACE = 0.99
LONGEST_SILENCE_S = 0.05
PATIENCE_S = 20.0  # for the answers to a case
SETTLE_S = 0.5  # before and after a case
ENDS_IT = ("shutdown", "quit")
CHANGES_TIME = ("set_speed", "pause_time", "resume_time", "step")  # of purpose
HEAD = "{method} {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n"
ARGUMENTS = {
    "load": "external_control.urp",
    "load installation": "small.installation",
    "generate flight report": "system",
    "generate support file": ".",
    "popup": "x",
    "addToLog": "x",
    "setUserRole": "operator",
    "set operational mode": "manual",
}
VALUES: dict[str, object] = {
    "kind": "int",
    "condition": "timestamp > 0",
    "path": "small.script",
    "text": "set_digital_out(0, True)\n",
    "line": "robotmode",
    "data": "",
}
OF_VERB: dict[str, dict[str, object]] = {
    "inject_fault": {"kind": "drop_connection", "port": "realtime"},  # not the port of the client that measures
}
BODIES = {PUT_STATE: "POWER_ON", PUT_PROGRAM_STATE: "stop"}
OF_TYPE: dict[object, object] = {int: 1, float: 0.5, bool: True, str: "x", list[int]: [1], list[float]: [0.0] * 6}


@dataclass(frozen=True)
class Case:
    """Something that others make a robot do. act: does it, and returns when it is answered."""

    name: str
    act: Callable[[EmulatorProcess, int], None]
    version: str = ""


# requests


def send(robot: EmulatorProcess, port: str, data: bytes, answers: int = 0, mark: bytes = b"HTTP/1.1 ") -> int:
    """Send in one write; read until there are so many answers, or the connection is closed. Returns their number."""
    seen, rest, until = 0, b"", time.monotonic() + PATIENCE_S
    with closing(socket.create_connection((robot.host, robot.ports[port]))) as connection:
        connection.settimeout(0.2)
        waiting = memoryview(data)
        while (waiting or seen < answers) and time.monotonic() < until:
            with suppress(TimeoutError):
                if waiting:
                    waiting = waiting[connection.send(waiting[: 1 << 16]) :]
            with suppress(TimeoutError):
                connection.settimeout(0.001 if waiting else 0.2)
                received = connection.recv(1 << 18)
                if not received:
                    break
                rest += received
                seen += rest.count(mark)
                rest = rest[1 - len(mark) :] if len(mark) > 1 else b""
                connection.settimeout(0.2)
    return seen


def dashboard(line: str) -> Callable[[EmulatorProcess, int], None]:
    def act(robot: EmulatorProcess, count: int) -> None:
        send(robot, "dashboard", f"{line}\n".encode() * count, count + 1, b"\n")

    return act


def dashboard_and_leave(line: str) -> Callable[[EmulatorProcess, int], None]:
    def act(robot: EmulatorProcess, count: int) -> None:
        send(robot, "dashboard", f"{line}\n".encode() * count)

    return act


def http(port: str, request: bytes) -> Callable[[EmulatorProcess, int], None]:
    def act(robot: EmulatorProcess, count: int) -> None:
        send(robot, port, request * count, count)

    return act


def message(method: str, path: str, body: object = None, kind: str = "application/json") -> bytes:
    content = b"" if body is None else body if isinstance(body, bytes) else json.dumps(body).encode()
    head = HEAD.format(method=method, path=path)
    if body is not None:
        head += f"Content-Type: {kind}\r\nContent-Length: {len(content)}\r\n"
    return head.encode() + b"\r\n" + content


def arguments(verb: Verb) -> dict[str, object]:
    fields = msgspec.structs.fields(verb.parameters)
    given = {each.name: VALUES.get(each.name, OF_TYPE.get(each.type, 1)) for each in fields if each.required}
    return given | OF_VERB.get(verb.name, {})


def requests() -> Iterator[Case]:
    for name, command in COMMANDS.items():
        if name not in ENDS_IT:
            words = command.form.words
            argument = ARGUMENTS.get(words, "") if command.form.takes_argument else ""
            yield Case(f"dashboard {name}", dashboard(f"{words} {argument}".strip()))
    for name, verb in verbs_of(LiveControl.SUBJECTS).items():
        if name not in CHANGES_TIME:
            yield Case(f"verb {name}", http("control", message("POST", f"/verbs/{name}", arguments(verb))))
    for path in ("/", "/openapi.json", "/verbs", "/metrics", "/nothing"):
        yield Case(f"control GET {path}", http("control", message("GET", path)))
    for operation in OPERATIONS:
        place = operation.endpoint
        body = None
        if operation.body is not None:
            (only, *_) = msgspec.structs.fields(operation.body)
            body = {only.name: BODIES.get(place, "x")}
        path = BASE + re.sub(r"\{.*\}", "x", place.path)
        yield Case(
            f"robot api {place.method} {place.path}", http("robot api", message(place.method, path, body)), "10.12"
        )
    yield Case("dashboard: clients that leave", dashboard_and_leave("generate support file ."))


# hostile HTTP


def one_byte_chunks(robot: EmulatorProcess, count: int) -> None:
    head = HEAD.format(method="POST", path="/verbs/robot_mode") + "Content-Type: application/json\r\n"
    send(robot, "control", f"{head}Transfer-Encoding: chunked\r\n\r\n".encode() + b"1\r\n \r\n" * (1000 * count), 1)


def endless_headers(robot: EmulatorProcess, count: int) -> None:
    send(robot, "control", b"GET / HTTP/1.1\r\n" + b"A: b\r\n" * (1000 * count), 1)


def endless_header(robot: EmulatorProcess, count: int) -> None:
    send(robot, "control", b"GET / HTTP/1.1\r\nA: " + b"b" * (6000 * count), 1)


# hostile files, in the programs folder


def waits(count: int) -> bytes:
    return gzip.compress(_program("<Wait/>" * count))


def _program(nodes: str, attributes: str = "") -> bytes:
    return (
        f'<URProgram name="x" installation="none"{attributes}><children><MainProgram><children>{nodes}</children>'
        "</MainProgram></children></URProgram>"
    ).encode()


def files(folder: Path) -> None:
    """Write the hostile files."""
    many = "".join(f' a{number}="1"' for number in range(500_000))
    contents: dict[str, bytes | Sequence[bytes]] = {
        "elements.urp": waits(1_000_000),
        "elements_allowed.urp": waits(100_000),
        "comments.urp": gzip.compress(_program('<Comment comment="x"/>' * 50_000)),
        "depth.urp": gzip.compress(_program("<a>" * 100_000)),
        "attributes.urp": gzip.compress(_program("", many)),
        "attribute_bytes.urp": gzip.compress(_program("", f' a="{"x" * 15_000_000}"')),
        "late_elements.urp": gzip.compress(_program("<Wait/>" * 130_000, f' a="{"x" * 900_000}"')),
        "text.urp": gzip.compress(_program(f"<Wait>{'x' * 15_000_000}</Wait>")),
        "bomb.urp": gzip.compress(b"<URProgram>" + b" " * 100_000_000),
        "beside.urp": gzip.compress(_program("<Nothing/>")),
        "beside.script": b"x = 1\n" * 3_000_000,
        "lines.script": b"x = 1\n" * 3_500_000,
        "one_line.script": b"x = " + b"1 + " * 5_000_000 + b"1\n",
        "block.script": b"def f():\n" + b"  x = 1\n" * 2_500_000 + b"end\n",
        "blocks.script": b"def f():\n  x = 1\nend\n" * 1_000_000,
        "allowed.script": b"def f():\n" + b"  x = 1\n" * 200_000 + b"end\n",
        "elements.installation": gzip.compress(b"<Installation>" + b"<a/>" * 1_000_000 + b"</Installation>"),
        "allowed.installation": gzip.compress(b"<Installation>" + b"<a/>" * 18_000 + b"</Installation>"),
        "small.installation": gzip.compress(b"<Installation/>"),
        "small.script": b"set_digital_out(0, True)\n",
        "elements.urpx": json.dumps({"program": [{}] * 900_000}).encode(),
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else b"".join(content))
    for name in ("sparse.urp", "sparse.script", "sparse.installation", "sparse.urpx"):
        with (folder / name).open("wb") as sparse:
            sparse.truncate(8 << 30)


def file_cases(folder: Path) -> Iterator[Case]:
    for path in sorted(folder.iterdir()):
        if path.suffix in (".urp", ".script"):
            yield Case(f"file {path.name}", _once(dashboard(f"load {path.name}")))
        elif path.suffix == ".installation":
            yield Case(f"file {path.name}", _once(dashboard(f"load installation {path.name}")))
        elif path.suffix == ".urpx":
            body = message("PUT", f"{BASE}/program/v1/loaded", {"name": path.stem})
            yield Case(f"file {path.name}", _once(http("robot api", body)), "10.12")


def _once(act: Callable[[EmulatorProcess, int], None]) -> Callable[[EmulatorProcess, int], None]:
    return lambda robot, _: act(robot, 1)


# measuring


class BareLoop:
    """A process that does nothing but wait for the next period: ``report`` gives its longest gap and its pace."""

    def __init__(self) -> None:
        command = [sys.executable, __file__, "--bare"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def report(self) -> dict[str, float]:
        out, _ = self._process.communicate(timeout=60)
        report: dict[str, float] = json.loads(out)
        return report


def bare() -> None:
    """The process of a BareLoop, until its standard input ends."""
    import threading

    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    print("runs", flush=True)
    longest, last = 0.0, time.monotonic()
    began, periods, due = last, 0, last
    while not ended.is_set():
        due += PERIOD_S
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        longest, last, periods = max(longest, now - last), now, periods + 1
        if now - due > 0.25:
            due = now
    print(json.dumps({"silence_s": longest, "pace": periods * PERIOD_S / (last - began)}))


def measure(case: Case, robot: EmulatorProcess, count: int) -> dict[str, object]:
    client, loop = Witness(robot), BareLoop()
    time.sleep(SETTLE_S)
    began = time.monotonic()
    problem = ""
    try:
        case.act(robot, count)
    except OSError as error:
        problem = str(error)
    took_s = time.monotonic() - began
    time.sleep(SETTLE_S)
    slept = loop.report()
    try:
        seen = client.report()
    except ValueError:  # it was disconnected, and has no report
        seen, problem = {"pace": 0.0, "silence_s": took_s}, "the client lost its connection"
    met = seen["pace"] >= LEAST_PACE * slept["pace"] and seen["silence_s"] <= slept["silence_s"] + LONGEST_SILENCE_S
    return {
        "case": case.name,
        "met": met,
        "pace": round(seen["pace"], 3),
        "bare": round(slept["pace"], 3),
        "silence_ms": round(1e3 * seen["silence_s"], 1),
        "bare_ms": round(1e3 * slept["silence_s"], 1),
        "took_s": round(took_s, 2),
        "problem": problem,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="requests of each case (default: %(default)s)")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--bare", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("cases", nargs="*", help="words in the names of cases; all by default")
    options = parser.parse_args()
    if options.bare:
        bare()
        return 0
    missed, rows = 0, []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files(folder)
        cases = [
            *file_cases(folder),
            *requests(),
            Case("http: chunks of one byte", one_byte_chunks),
            Case("http: endless headers", endless_headers),
            Case("http: an endless header", endless_header),
        ]
        for version in ("", "10.12"):
            chosen = [case for case in cases if case.version == version]
            chosen = [case for case in chosen if not options.cases or any(word in case.name for word in options.cases)]
            if not chosen:
                continue
            more = ("--polyscope", version) if version else ()
            with emulator("--programs", name, *more) as robot:
                for case in chosen:
                    row = measure(case, robot, options.count)
                    missed += not row["met"]
                    rows.append(row)
                    print("ok    " if row["met"] else "MISSED", *row.values(), flush=True)
                if "Traceback" in robot.output:
                    print(robot.output)
                    missed += 1
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
