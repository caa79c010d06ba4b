"""The External Control URCap: in place of its nodes, a program runs the code that a driver sends when it is played.

    robot -> driver   request_program\\n
    driver -> robot   the whole program, after which the connection stays open

The driver sends no length and does not close the connection, so the program is complete when no more data
arrives. Behaviour, limits and texts are those of the public URCap
(UniversalRobots/Universal_Robots_ExternalControl_URCap). The URCap itself uses what has arrived when it
checks, which truncates a program on a slow network.
"""

import re
from dataclasses import dataclass
from typing import Final

from emulator.services.sockets import ScriptSocket, ScriptSocketBackend
from urproto.compat import Self
from urproto.text import from_bytes
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.numbers import quoted
from urscript.polyscope.writer import ExternalControlCode

_HOST: Final = "192.168.56.1"
_PORT: Final = 50002
_REQUEST: Final = b"request_program\n"
_CONNECT_S: Final = 5.0
_SILENCE_S: Final = 0.5  # after which an incomplete line is given up
_PAUSE_S: Final = 0.02  # after which a program with its known last line is complete (guess)
_LONG_PAUSE_S: Final = 0.1  # after which a program without a known last line is complete (guess)
_WHOLE_S: Final = 10.0  # for the whole program (guess; the URCap would continue to wait)
_MAX_BYTES: Final = 256 * 1024  # guess: the official program has 48 kB
_LAST_LINE: Final = b"# NODE_CONTROL_LOOP_ENDS"
_HEADER_BEGIN: Final = re.compile(r"^ *# HEADER_BEGIN *$", re.MULTILINE)
_HEADER_END: Final = re.compile(r"^ *# HEADER_END *$", re.MULTILINE)
_LINE_END: Final = re.compile(r"\r\n?|\n")
_WELL_FORMED: Final = re.compile(r"(?P<host>\[[^\]\s]+\]|[^:\s\[\]]*)(?::(?P<port>[0-9]{1,5}))?")
_URCAP: Final = "External Control"
_NOTHING: Final = "null"  # Java's text for a missing line: such a program does not compile (observed)


@dataclass(frozen=True, slots=True)
class DriverAddress:
    """Address at which the driver serves programs; None uses the installation's value, else the URCap's default."""

    host: str | None = None
    port: int | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """``HOST``, ``:PORT`` or ``HOST:PORT``, an IPv6 address in brackets. Raises ValueError."""
        match = _WELL_FORMED.fullmatch(text.strip())
        host, digits = (match["host"], match["port"]) if match else ("", None)
        if not (host or digits) or (digits is not None and not 0 < int(digits) < 65536):
            raise ValueError(
                f"{text!r} is not the address of a driver: use HOST:PORT, HOST or :PORT, with ports from 1 to 65535"
            )
        return cls(host.strip("[]") or None, int(digits) if digits else None)

    @classmethod
    def of(cls, installation: InstallationFile) -> Self:
        """Address from the URCap's page in an installation."""
        data = installation.contributions.get(_URCAP, {})
        port = data.get("port_nr", "").strip()
        valid = re.fullmatch("[0-9]{1,5}", port) is not None and 0 < int(port) < 65536
        return cls(data.get("host_ip", "").strip() or None, int(port) if valid else None)

    def over(self, other: "DriverAddress") -> "DriverAddress":
        """This address, completed by another one."""
        return DriverAddress(self.host or other.host, self.port or other.port)

    @property
    def complete(self) -> tuple[str, int]:
        """Host and port, with the URCap's defaults."""
        return self.host or _HOST, self.port or _PORT


def split_program(program: str) -> ExternalControlCode:
    """Split a program into the text between the anchors of the header and the text after it; text before is dropped.

    Without anchors, the whole program belongs to the node.
    """
    begin = _HEADER_BEGIN.search(program)
    end = _HEADER_END.search(program, begin.end()) if begin else None
    if begin is None or end is None:
        return ExternalControlCode("", program)
    return ExternalControlCode(program[begin.start() : end.end()], program[end.end() :].removeprefix("\n"))


class ProgramRequest:
    """One request for a program, advanced once per control period."""

    def __init__(self, backend: ScriptSocketBackend, address: tuple[str, int], period_s: float) -> None:
        self._period_s = period_s
        self._where = f"{address[0]}:{address[1]}"
        self._socket: ScriptSocket = backend.open(*address)
        self._requested = False
        self._time_s = 0.0  # since connecting began, or since the request was sent
        self._quiet_s = 0.0  # since something arrived
        self._size = 0

    def step(self) -> ExternalControlCode | None:
        """Advance; returns the code for the nodes (a popup if the driver did not answer), None until it is known."""
        self._time_s += self._period_s
        code = self._receive() if self._requested else self._connect()
        if code is not None:
            self.close()
        return code

    def close(self) -> None:
        self._socket.close()

    def _connect(self) -> ExternalControlCode | None:
        socket = self._socket
        if socket.state == "open":
            socket.send(_REQUEST)
            self._requested, self._time_s = True, 0.0
            return None
        if socket.state == "closed":
            return self._closed()
        return self._timeout() if self._time_s > _CONNECT_S else None

    def _receive(self) -> ExternalControlCode | None:
        socket = self._socket
        ended = socket.state == "closed"  # checked first: then everything received before the end is in the inbox
        size = len(socket.inbox)
        self._quiet_s = 0.0 if size != self._size else self._quiet_s + self._period_s
        self._size = size
        if size > _MAX_BYTES:
            return self._unreachable(f"the program has more than {_MAX_BYTES >> 10} KiB")
        if ended:
            return self._closed()
        if self._complete():
            return self._program()
        given_up = self._quiet_s >= _SILENCE_S or self._time_s > _WHOLE_S
        return self._timeout() if given_up else None

    def _closed(self) -> ExternalControlCode:
        failure = self._socket.failure
        return self._unreachable(failure) if failure and not self._socket.inbox else self._program()

    def _complete(self) -> bool:
        inbox = self._socket.inbox
        if self._quiet_s < _PAUSE_S or not inbox.endswith((b"\n", b"\r")):
            return False
        return self._quiet_s >= _LONG_PAUSE_S or _LAST_LINE in inbox

    def _program(self) -> ExternalControlCode:
        text = from_bytes(self._socket.inbox)
        lines = _LINE_END.sub("\n", text).removesuffix("\n") if text else _NOTHING
        return split_program(" " + lines.replace("\n", "\n ") + "\n")

    def _unreachable(self, reason: str) -> ExternalControlCode:
        return _popup(f"The connection to the remote PC at {self._where} could not be established. Reason: {reason}")

    def _timeout(self) -> ExternalControlCode:
        return _popup(f"Timeout while reading requested program from {self._where}")


def _popup(text: str) -> ExternalControlCode:
    """Code of the node after a failure: notify the operator, and wait."""
    return ExternalControlCode(
        "", f'popup({quoted(text)}, "Receive program failed", False, True, blocking=True)\nsync()\n'
    )
