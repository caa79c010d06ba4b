"""The ports that speak in lines told to people: dashboard, interpreter mode, scripts, grippers."""

from collections.abc import Iterator

from client.decoding import formatting
from client.decoding.streams import Line, LineStream, trouble
from urproto import interpreter
from urproto.errors import RemoteProtocolError
from urproto.interpreter import InterpreterCommand

_LONGEST_LINE = 8192  # bytes; what is longer is told in pieces


def line_stream() -> LineStream:
    """Any text with line ends."""
    return LineStream(_read, _LONGEST_LINE)


def unended_stream() -> LineStream:
    """Text whose lines may lack their end, as a gripper's ``ack``: what comes together is told together."""
    return LineStream(_read, _LONGEST_LINE, unfinished=True)


def statement_stream() -> LineStream:
    """What a client of interpreter mode sends."""
    return LineStream(_read_statement, _LONGEST_LINE)


def answer_stream() -> LineStream:
    """What interpreter mode answers."""
    return LineStream(_read_answer, _LONGEST_LINE)


def _read(text: str) -> Iterator[Line]:
    yield Line(formatting.escaped(text))


def _read_statement(text: str) -> Iterator[Line]:
    command = InterpreterCommand.of(text)
    yield Line(f"command {command.value}" if command else f"statements: {formatting.escaped(text)}")


def _read_answer(text: str) -> Iterator[Line]:
    try:
        answer = interpreter.parse_answer(text)
    except RemoteProtocolError:
        yield trouble(f"no answer of interpreter mode: {formatting.quoted(text)}")
        return
    if answer.number is None:
        yield Line(f"discarded, {formatting.escaped(answer.reason)}: {formatting.escaped(answer.line)}")
    else:
        yield Line(formatting.escaped(text))


class BytesStream:
    """Bytes nobody here can read, as they come."""

    def __init__(self) -> None:
        self._offset = 0

    def feed(self, data: bytes) -> Iterator[Line]:
        """Tell how many, and the first."""
        yield trouble(f"offset {self._offset}: {len(data)} bytes of no known protocol: {formatting.value(data)}")
        self._offset += len(data)

    def lost(self, size: int) -> None:
        """Count them."""
        self._offset += size

    def end(self) -> Iterator[Line]:
        """Nothing is unfinished."""
        yield from ()
