"""The Debug Adapter Protocol on standard input and output: what editors speak with debuggers.

Source of the messages: the protocol's specification, https://microsoft.github.io/debug-adapter-protocol.
"""

import json
import os
import queue
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

from emulator.branches import can_branch
from emulator.debugger.attached import Attached
from emulator.debugger.debuggee import Debuggee
from emulator.debugger.travel import Traveller
from emulator.peers.file import read_peers
from emulator.programs.stepping import Breakpoint, Frame, Stop
from emulator.virtual import virtual_robot
from urproto.controlapi import ControlClient, NoControlError
from urproto.entry import SUCCESS
from urproto.errors import URError
from urproto.ports import CONTROL_API_PORT
from urscript.files import ScriptFile

_LARGEST: Final = 10_000_000  # bytes of a message
_FRAMES: Final = 1000  # of a thread
_GLOBALS: Final = 1  # references of scopes; those of a frame's variables follow
_ROBOT: Final = 2
_FIRST_FRAME: Final = 1000
_SOURCE: Final = 1  # reference of the text that a robot runs
_CAPABILITIES: Final = {
    "supportsConfigurationDoneRequest": True,
    "supportsFunctionBreakpoints": True,
    "supportsConditionalBreakpoints": True,
    "supportsHitConditionalBreakpoints": True,
    "supportsLogPoints": True,
    "supportsEvaluateForHovers": True,
    "supportsStepBack": True,
    "supportsSetVariable": True,
    "supportsTerminateRequest": True,
    "exceptionBreakpointFilters": [
        {"filter": "exception", "label": "Runtime exceptions", "default": True},
        {"filter": "protective stop", "label": "Protective and other safety stops", "default": True},
    ],
}
_MOVES: Final = {"continue": "continue", "next": "over", "stepIn": "in", "stepOut": "out"}
_BACKWARDS: Final = {"stepBack": "over", "reverseContinue": "continue"}
_REASONS: Final = {"protective stop": "exception"}

Arguments = Mapping[str, Any]


class RequestError(Exception):
    """A request that cannot be carried out; the text is shown to the user."""


def read_message(stream: BinaryIO) -> dict[str, Any] | None:
    """The next message; None at the end. Raises ValueError for what is not one."""
    length = -1
    while line := stream.readline(_LARGEST):
        name, _, value = line.strip().partition(b":")
        if name.lower() == b"content-length" and value.strip().isdigit():
            length = int(value)
        if not line.strip() and length >= 0:
            break
    else:
        return None
    if length > _LARGEST:
        raise ValueError(f"a message of {length} bytes is too long")
    message = json.loads(stream.read(length))
    if not isinstance(message, dict):
        raise ValueError("a message is an object")
    return message


class Adapter:
    """One debugging session. A method ``_on_NAME`` answers the request NAME."""

    def __init__(self, source: BinaryIO, sink: BinaryIO) -> None:
        self._source = source
        self._sink = sink
        self._inbox: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self._later: list[dict[str, Any]] = []
        self._sequence = 0
        self._traveller: Traveller | Attached | None = None
        self._file = Path()
        self._stop_on_entry = False
        self._lines: list[Breakpoint] = []
        self._functions: list[str] = []
        self._stop_on = ["exception", "protective stop"]
        self._frames: list[tuple[int, int]] = []  # thread and number of the frames that were shown, by reference
        self._running = ""  # how the program goes on, while it does
        self._pausing = False
        self._over = False

    def serve(self) -> None:
        """Answer until the editor ends the session."""
        threading.Thread(target=self._read, daemon=True).start()
        try:
            while not self._over and (message := self._next()) is not None:
                self._handle(message)
                while self._running and not self._over:
                    self._go_on()
        finally:
            if self._traveller is not None:
                self._traveller.close()

    def _read(self) -> None:
        try:
            while (message := read_message(self._source)) is not None:
                self._inbox.put(message)
        except ValueError as error:
            self._say(f"the editor sent no message: {error}", "stderr")
        self._inbox.put(None)

    def _next(self) -> dict[str, Any] | None:
        return self._later.pop(0) if self._later else self._inbox.get()

    # messages

    def _handle(self, message: dict[str, Any]) -> None:
        command, arguments = str(message.get("command", "")), message.get("arguments") or {}
        answer: Callable[[Arguments], Any] | None = getattr(self, f"_on_{command}", None)
        reply: dict[str, Any] = {"request_seq": message.get("seq", 0), "command": command}
        try:
            if command in _MOVES or command in _BACKWARDS:
                body = self._move(command)
            elif answer is None:
                raise RequestError(f"the debugger has no request {command!r}")
            else:
                body = answer(arguments)
        except (RequestError, ValueError, OSError, URError, KeyError, TypeError) as error:
            text = f"the request {command} lacks {error}" if isinstance(error, KeyError) else str(error)
            self._send("response", {**reply, "success": False, "message": text})
            return
        self._send("response", {**reply, "success": True, "body": body or {}})
        if command == "initialize":
            self._event("initialized")
        if command in _BACKWARDS and isinstance(self._started, Traveller):  # the others refuse it above
            self._stopped(self._started.back(_BACKWARDS[command]))

    def _send(self, kind: str, content: dict[str, Any]) -> None:
        self._sequence += 1
        data = json.dumps({"seq": self._sequence, "type": kind, **content}).encode()
        self._sink.write(b"Content-Length: %d\r\n\r\n%b" % (len(data), data))
        self._sink.flush()

    def _event(self, name: str, body: dict[str, Any] | None = None) -> None:
        self._send("event", {"event": name, "body": body or {}})

    # requests

    def _on_initialize(self, arguments: Arguments) -> Any:
        return _CAPABILITIES

    def _on_launch(self, arguments: Arguments) -> None:
        """program, model, polyscope, options (of `virtual_robot`), peers, stopOnEntry."""
        if not can_branch():
            raise RequestError("this system cannot copy processes, which the debugger needs: use Linux or macOS")
        self._file = Path(str(arguments["program"]))
        options = {"running": True, "popup_auto_close_s": 0.0, **arguments.get("options", {})}
        if version := arguments.get("polyscope"):
            options["polyscope"] = str(version)
        robot = virtual_robot(arguments.get("model"), recorded=False, **options)
        peers = read_peers(Path(str(arguments["peers"]))) if arguments.get("peers") else None
        self._stop_on_entry = bool(arguments.get("stopOnEntry", False))
        debuggee = Debuggee(robot, ScriptFile.read(str(self._file)), peers)
        self._traveller = Traveller(debuggee, self._interrupted)

    def _on_attach(self, arguments: Arguments) -> None:
        """host, port and token of the emulator's control API; program: the file that is open in the editor."""
        host, port = str(arguments.get("host", "127.0.0.1")), int(arguments.get("port", CONTROL_API_PORT))
        client = ControlClient(host, port, str(arguments.get("token", "")))
        file = None
        if arguments.get("program"):
            self._file = Path(str(arguments["program"]))
            file = ScriptFile.read(str(self._file))
        self._traveller = attached = Attached(client, file, self._interrupted)
        self._event("capabilities", {"capabilities": {"supportsStepBack": False}})
        if attached.busy:
            self._say("a program is running already: it cannot be stopped until it is started again", "console")

    def _on_configurationDone(self, arguments: Arguments) -> None:  # noqa: N802
        traveller = self._started
        self._apply_breakpoints()
        traveller.begin()
        self._running = "pause" if self._stop_on_entry else "continue"

    def _on_setBreakpoints(self, arguments: Arguments) -> Any:  # noqa: N802
        entries = arguments.get("breakpoints", [])
        self._lines = [
            Breakpoint(
                int(entry["line"]), str(entry.get("condition") or ""), _hits(entry), str(entry.get("logMessage") or "")
            )
            for entry in entries
        ]
        self._apply_breakpoints()
        return {"breakpoints": [{"verified": True, "line": one.line} for one in self._lines]}

    def _on_setFunctionBreakpoints(self, arguments: Arguments) -> Any:  # noqa: N802
        self._functions = [str(entry["name"]) for entry in arguments.get("breakpoints", [])]
        self._apply_breakpoints()
        return {"breakpoints": [{"verified": True} for _ in self._functions]}

    def _on_setExceptionBreakpoints(self, arguments: Arguments) -> None:  # noqa: N802
        self._stop_on = [str(name) for name in arguments.get("filters", [])]
        self._apply_breakpoints()

    def _on_threads(self, arguments: Arguments) -> Any:
        threads = self._started.ask("threads") or {0: "program"}
        return {"threads": [{"id": number + 1, "name": name} for number, name in threads.items()]}

    def _on_stackTrace(self, arguments: Arguments) -> Any:  # noqa: N802
        thread = int(arguments["threadId"]) - 1
        frames: list[Frame] = self._started.ask("stack", thread)[:_FRAMES]
        source: dict[str, Any] = {"name": self._file.name, "path": str(self._file.resolve())}
        if isinstance(self._started, Attached) and self._started.ask("source") is not None:
            source = {"name": "program of the robot", "sourceReference": _SOURCE}
        shown = []
        for number, frame in enumerate(frames):
            self._frames.append((thread, number))
            line = self._started.stop.line if number == 0 and thread == self._started.stop.thread else frame.line
            reference = _FIRST_FRAME + len(self._frames) - 1
            shown.append({"id": reference, "name": frame.name, "line": line, "column": 1, "source": source})
        return {"stackFrames": shown, "totalFrames": len(shown)}

    def _on_source(self, arguments: Arguments) -> Any:
        """The text of a program that is not the editor's file."""
        return {"content": self._started.ask("source") or ""}

    def _on_scopes(self, arguments: Arguments) -> Any:
        reference = int(arguments["frameId"])
        names = (("Locals", reference), ("Globals", _GLOBALS), ("Robot", _ROBOT))
        return {"scopes": [{"name": name, "variablesReference": ref, "expensive": False} for name, ref in names]}

    def _on_variables(self, arguments: Arguments) -> Any:
        reference = int(arguments["variablesReference"])
        if reference == _GLOBALS:
            values = self._started.ask("globals")
        elif reference == _ROBOT:
            values = self._started.ask("robot_state")
        else:
            thread, number = self._frame(reference)
            values = self._started.ask("stack", thread)[number].variables
        return {"variables": [{"name": n, "value": v, "variablesReference": 0} for n, v in values.items()]}

    def _on_setVariable(self, arguments: Arguments) -> Any:  # noqa: N802
        reference = int(arguments["variablesReference"])
        if reference == _ROBOT:
            raise RequestError("the robot's values cannot be set")
        stop, local = self._started.stop, reference != _GLOBALS
        thread, number = self._frame(reference) if local else (stop.thread, 0)
        name, text = str(arguments["name"]), str(arguments["value"])
        value = self._started.ask("set_variable", name, text, thread, number, local=local)
        return {"value": value}

    def _on_evaluate(self, arguments: Arguments) -> Any:
        reference = arguments.get("frameId")
        thread, number = self._frame(int(reference)) if reference is not None else (self._started.stop.thread, 0)
        return {
            "result": self._started.ask("evaluate", str(arguments["expression"]), thread, number),
            "variablesReference": 0,
        }

    def _on_pause(self, arguments: Arguments) -> None:
        """While it runs; a program that stands still is paused already."""
        self._pausing = True

    def _on_disconnect(self, arguments: Arguments) -> None:
        self._over = True

    def _on_terminate(self, arguments: Arguments) -> None:
        self._event("terminated")
        self._over = True

    # running

    @property
    def _started(self) -> Traveller | Attached:
        if self._traveller is None:
            raise RequestError("no program has been launched")
        return self._traveller

    def _frame(self, reference: int) -> tuple[int, int]:
        place = reference - _FIRST_FRAME
        if not 0 <= place < len(self._frames):
            raise RequestError("the program has gone on since: ask for its stack again")
        return self._frames[place]

    def _apply_breakpoints(self) -> None:
        if self._traveller is not None:
            self._traveller.set_breakpoints(self._lines, self._functions, self._stop_on)

    def _move(self, command: str) -> Any:
        if self._started.stop.reason == "ended" and command in _MOVES:
            raise RequestError("the program has ended: go back, or launch it again")
        if command in _BACKWARDS and isinstance(self._started, Attached):
            raise RequestError("time cannot be turned back on an emulator with clients: launch the program to go back")
        self._frames.clear()
        if command in _MOVES:
            self._running = _MOVES[command]
        return {"allThreadsContinued": True}

    def _go_on(self) -> None:
        try:
            for stop in self._started.go(self._running):
                self._tell(stop)
                if stop.reason:
                    self._running = ""
                    self._stopped(stop)
                if self._over:
                    return
        except NoControlError as error:  # the emulator has ended
            self._say(str(error), "stderr")
            self._on_terminate({})

    def _stopped(self, stop: Stop) -> None:
        self._pausing = False
        if stop.reason == "ended":
            if stop.text:
                self._say(f"it did not start: {stop.text}", "stderr")
            self._event("terminated")
            self._event("exited", {"exitCode": 0})
            return
        reason = _REASONS.get(stop.reason, stop.reason)
        if reason == "pause" and self._stop_on_entry:
            reason, self._stop_on_entry = "entry", False
        body = {"reason": reason, "threadId": stop.thread + 1, "allThreadsStopped": True}
        self._event("stopped", body | ({"text": stop.text, "description": stop.text} if stop.text else {}))

    def _tell(self, stop: Stop) -> None:
        for text in stop.output:
            self._say(text, "stdout")

    def _say(self, text: str, category: str) -> None:
        self._event("output", {"category": category, "output": f"{text}\n"})

    def _interrupted(self) -> bool:
        """Between slices of a run: answer what can be answered meanwhile; whether the program is to stop."""
        for message in self._arrived():
            if message.get("command") in (*_MOVES, *_BACKWARDS):
                self._later.append(message)
            else:
                self._handle(message)
        return self._pausing or self._over

    def _arrived(self) -> Iterator[dict[str, Any]]:
        while not self._inbox.empty():
            if (message := self._inbox.get()) is None:
                self._over = True
                return
            yield message


def _hits(entry: Arguments) -> int:
    text = str(entry.get("hitCondition") or "1").strip(" >=")
    if not text.isdecimal():
        raise RequestError(f"{entry['hitCondition']!r} is not a number of hits")
    return int(text)


def run() -> int:
    """Serve one session on standard input and output, which nothing else may write to."""
    source = os.fdopen(os.dup(sys.stdin.fileno()), "rb")  # left open: a thread waits for it until the process ends
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as sink:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        Adapter(source, sink).serve()
    return SUCCESS
