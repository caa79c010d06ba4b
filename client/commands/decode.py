"""``ur-client decode``: what went over a wire, one line a message."""

import json
import sys
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import asdict
from enum import Enum
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Annotated

import typer

from client.decoding.codecs import CODECS, Side
from client.decoding.session import Choice, InputForm, Session
from client.decoding.streams import Line

__all__ = ["decode_command"]

_CHUNK = 65536  # bytes
_UNREADABLE = 1  # exit status when something could not be decoded

CodecName = Enum("CodecName", {name: name for name in CODECS}, type=str)  # type: ignore[misc] # made for the help text


def decode_command(
    file: Annotated[str, typer.Argument(help="Captured bytes, the same as hexadecimal text, or a pcap; - is stdin.")],
    codec: Annotated[
        CodecName | None, typer.Option("--as", help="What the bytes are; else port or look decide.")
    ] = None,
    side: Annotated[
        Side | None, typer.Option("--from", help="Who sent bytes of one direction (the driver is a client).")
    ] = None,
    port: Annotated[
        list[int] | None,
        typer.Option("--port", help="The port the bytes are of; in a pcap, show this one. Repeatable."),
    ] = None,
    port_offset: Annotated[int, typer.Option("--port-offset", help="What the emulator added to each port.")] = 0,
    form: Annotated[InputForm, typer.Option("--input", help="What the file is.")] = InputForm.AUTO,
    as_json: Annotated[bool, typer.Option("--json", help="Print a line of JSON for every message.")] = False,
) -> None:
    """Print a captured stream of any controller port, one line a message. A line with ! could not be read: status 1."""
    chosen = CODECS[codec.value] if codec else None
    session = Session(Choice(chosen, side, tuple(port or ()), port_offset, form), _as_json if as_json else None)
    with ExitStack() as opened:
        source = _stdin() if file == "-" else _open(file, opened)
        try:
            _pump(source, session)
        except KeyboardInterrupt:  # the usual end of an endless stream
            _show(session.end())
    if session.troubles:
        raise typer.Exit(_UNREADABLE)


def _as_json(line: Line) -> str:
    return json.dumps(asdict(line))


def _stdin() -> BufferedIOBase:
    stdin = sys.stdin.buffer
    assert isinstance(stdin, BufferedIOBase)
    return stdin


def _open(file: str, opened: ExitStack) -> BufferedReader:
    try:
        return opened.enter_context(Path(file).open("rb"))
    except OSError as error:
        raise typer.BadParameter(f"cannot read {file}: {error.strerror}") from error


def _pump(source: BufferedIOBase, session: Session) -> None:
    while data := source.read1(_CHUNK):
        _show(session.feed(data))
    _show(session.end())


def _show(lines: Iterable[str]) -> None:
    sys.stdout.write("".join(f"{line}\n" for line in lines))  # at once: Ctrl-C between lines would lose the rest
    sys.stdout.flush()
