"""A recorded session as a starting point: its messages are sent again, and choices move, drop, double or swap some.

    session: run.journal
    choices:
      network: {session: moved, by: -5..20, client: "port 30003", at: 2..8}
      lost: {session: dropped, kind: RTDE inputs}

``by`` is in control periods. A choice is about the first message at its moment or later that its ``client``, ``kind``
and ``at`` admit; it is decided so early that the message can still be sent earlier.
"""

import heapq
from bisect import bisect_left
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Literal

import msgspec

from emulator.control.control import is_waiting
from emulator.explore.choices import Domain, Kind, PlanError, Span, Target, Values, domain_of
from emulator.journal.file import DAMAGE, MAGIC, Record, frame_of, line_of, read_journal
from emulator.journal.trace import lane_of
from emulator.journal.values import Numbers, decode
from emulator.virtual import VirtualRobot
from urproto.controlapi import BadArguments, NotPossible
from urproto.robots import load_model
from urproto.structures import converted

_MOST_SHOWN: Final = 60  # characters of a message
_NOT_SENT: Final = {"file", "reboot", "tool"}  # records of what no client has sent: another run may have it otherwise
_CONNECTIONS: Final = {"socket", "modbus"}
_VERB_LANE: Final = "Control API"
_ORIGIN: Final = "a script from "


@dataclass(frozen=True)
class Message:
    """What a client has sent. period: before which, from the beginning of the session. record: as in the journal."""

    period: int
    record: Record
    client: str
    kind: str
    text: str

    def __str__(self) -> str:
        text = " ".join(self.text.split())
        return f"{self.client or self.kind}: {text if len(text) <= _MOST_SHOWN else f'{text[:_MOST_SHOWN]}...'}"


class Session:
    """The journal of a session. beginning: that of its robot before anything was sent.

    peers: whether the plan says who answers programs. Raises PlanError, OSError.
    """

    def __init__(self, file: Path, *, peers: bool) -> None:
        try:
            first, *records = read_journal(file)
            header, numbers = first[2], Numbers()
            since = header.get("begin", {}).get("periods", 0)
            self.beginning: bytes = MAGIC + frame_of([line_of(first)])
            self.messages = [_message(one, since, numbers) for one in records if one[1] in ("post", "verb")]
            self.model: str = header["model"]
            self.period_s = load_model(self.model).series.period_s
            self.lasts_s: float = (records[-1][0] - since) * self.period_s
        except OSError as error:
            raise PlanError(f"{file}: {error.strerror}") from error
        except (ValueError, *DAMAGE) as error:
            raise PlanError(f"{file} is no session: {error}") from error
        kinds = {record[1] for record in records}
        if wrong := ", ".join(sorted(kinds & _NOT_SENT)):
            raise PlanError(f"{file} cannot be explored: it has records of the kinds {wrong} (docs/journal.md)")
        if not peers and kinds & _CONNECTIONS:
            raise PlanError(f"programs of the session {file} use connections: name who answers them in peers")


def _message(record: Record, since: int, numbers: Numbers) -> Message:
    period, way, content, *rest = record
    if way == "verb":
        arguments = decode(rest.pop(0), numbers)
        shown = ", ".join(f"{name}={value!r}" for name, value in arguments.items())
        return Message(period - since, record, "".join(rest), _VERB_LANE, f"{content}({shown})")
    command = decode(content, numbers)
    origin = getattr(command, "origin", "")
    sender = origin.removeprefix(_ORIGIN) if origin.startswith(_ORIGIN) else "".join(rest)
    return Message(period - since, record, sender, lane_of(command), getattr(command, "text", "") or repr(command))


class _Entry(msgspec.Struct, forbid_unknown_fields=True):
    session: Literal["moved", "dropped", "doubled", "swapped"]
    by: int | str | None = None
    client: str = ""
    kind: str = ""


class ChangeMessage(Kind):
    """A message of the session is ``moved`` ``by`` periods, ``dropped``, ``doubled``, or ``swapped`` with the next one.

    client: part of its client's name. kind: as in `emulator.journal.trace`. Only two of one period are swapped.
    """

    def __init__(self, entry: Mapping[str, Any], session: Session) -> None:
        given = converted(entry, _Entry, "session", PlanError)
        by = domain_of(f"{given.by}..{given.by}" if isinstance(given.by, int) else given.by or "0..0")
        if not isinstance(by, Span) or not by.whole or (given.session == "moved") is (given.by is None):
            raise PlanError("session: a message is moved by LOW..HIGH control periods; no other has by")
        lead = -min(0, round(by.low))
        self.parameters: dict[str, Domain] = {} if given.by is None else {"by": by}
        self._change, self._session = given.session, session
        self._moments = [  # in which period it is decided, and the number of the message
            (max(0, one.period - lead), number)
            for number, (one, following) in enumerate(pairwise([*session.messages, None]))
            if one is not None
            and given.client in one.client
            and given.kind in ("", one.kind)
            and (self._change != "swapped" or (following is not None and following.period == one.period))
        ]

    def limited(self, at: Span) -> Span:
        period_s, messages = self._session.period_s, self._session.messages
        self._moments = [one for one in self._moments if at.low <= messages[one[1]].period * period_s <= at.high]
        if not self._moments:
            raise PlanError(f"the session has no message that can be {self._change} then")
        return Span(self._moments[0][0] * period_s, self._moments[-1][0] * period_s, whole=False)

    def settled(self, period: int) -> int:
        return self._moment(period)[0]

    def _moment(self, period: int) -> tuple[int, int]:
        return self._moments[min(bisect_left(self._moments, (period, -1)), len(self._moments) - 1)]

    def apply(self, target: Target, values: Values, period: int) -> None:
        target.sending.change(self._change, self._moment(period)[1], **values)

    def words(self, values: Values, period: int) -> str:
        number = self._moment(period)[1]
        message, period_s = self._session.messages[number], self._session.period_s
        sent = f"{message} (sent at {message.period * period_s:.3f} s)"
        if "by" in values:
            by = values["by"]
            return f"{sent} comes {abs(by) * period_s:.3g} s {'later' if by >= 0 else 'earlier'}"
        if self._change == "swapped":
            return f"{sent} comes after {self._session.messages[number + 1]}"
        return f"{sent} {'is lost' if self._change == 'dropped' else 'comes twice'}"


class Player:
    """Sends the messages of a session to a robot; each can be changed until then, by its number."""

    def __init__(self, messages: Sequence[Message], robot: VirtualRobot) -> None:
        self._robot = robot
        self._control = robot.served()
        self._numbers = Numbers()
        self._due: list[list[Any]] = [[one.period, number, 0, one] for number, one in enumerate(messages)]  # a heap
        self._entries = list(self._due)
        self._steps: list[Generator[None, None, Any]] = []

    def change(self, change: str, number: int, by: int = 0) -> None:
        """Change a message as the choice of that name does."""
        period, order, again, message = entry = self._entries[number]
        if change == "swapped":
            other = self._entries[number + 1]
            entry[3], other[3] = other[3], message
            return
        if change != "doubled":
            entry[3] = None
        if change != "dropped" and message is not None:
            self._entries[number] = [period + by, order, again + 1, message]
            heapq.heappush(self._due, self._entries[number])

    def send(self, period: int) -> None:
        """Send what is due before a control period."""
        while self._due and self._due[0][0] <= period:
            entry = heapq.heappop(self._due)
            message, entry[3] = entry[3], None
            if message is not None:
                self._send(message.record)

    def _send(self, record: Record) -> None:
        controller = self._robot.controller
        _, way, content, *rest = record
        if way == "post":
            controller.post(decode(content, self._numbers), client="".join(rest))
            return
        try:
            result = vars(self._control)[content](**decode(rest[0], self._numbers))
        except (BadArguments, NotPossible):  # it may have been possible then
            return
        if is_waiting(result):
            self._steps.append(result)
            self.go_on(1)

    def go_on(self, last: int = 0) -> None:
        """After a control period: continue verbs that wait, or only the last ones."""
        for steps in self._steps[-last:]:
            try:
                next(steps)
            except (BadArguments, NotPossible, StopIteration):
                self._steps.remove(steps)
