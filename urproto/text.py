"""Text from clients: the single place that converts between bytes and ``str``.

Strings of the controller are byte strings, and a client may send any bytes. Text is therefore represented like file
names in Python (PEP 383): decoded as UTF-8, with each byte that is not valid UTF-8 as a surrogate escape
(``from_bytes``). It is output

- as the original bytes by ``to_bytes``: on the controller's own ports, to sockets, into script files;
- as valid Unicode by ``readable``: as JSON and HTML, in logs and reports, in recordings, on Foxglove and ROS. A byte
  that is not valid UTF-8 then appears as ``\\xe9``. Streams and files do the same with ``errors=READABLE``.

No other code encodes or decodes data from clients.

What a protocol calls a blank, a digit or a number is ASCII. Python's ``str.split()``, ``strip()``, ``isdigit()``,
``int()`` and ``float()`` take more: 0x1c to 0x1f, 0x85 and all of Unicode's spaces as blanks, ``'²'`` and ``'٣'`` as
digits, ``'1_0'`` as ten. ``strip``, ``words``, ``lines``, ``lower``, ``whole_number`` and ``number`` take what the
protocols do.
"""

import codecs
import re
from collections.abc import Iterable
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from io import TextIOWrapper
from typing import Any, Final, TextIO, TypeVar, cast

_Value = TypeVar("_Value")

BLANKS: Final = " \t\n\r\f\v"
READABLE: Final = "readable"  # the error handler of that name

_OTHER_SURROGATES: Final = re.compile("[\ud800-\udc7f\udd00-\udfff]")
_SHOWN_BYTE: Final = re.compile(r"\\x([89a-f][0-9a-f])")
_LINE_BREAK: Final = re.compile("\r\n|\n|\r")
_WORD: Final = re.compile(rf"[^{BLANKS}]+")
_WHOLE: Final = re.compile(r"[+-]?[0-9]{1,400}")  # more digits than any number of a protocol has; int() refuses 4300
_NUMBER: Final = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")

_QUOTED: Final = 60  # characters of a value that an error shows
_FEW: Final = 20  # names that an error lists although it has found a close one


def from_bytes(data: bytes | bytearray) -> str:
    """Decode arbitrary bytes reversibly."""
    return data.decode("utf-8", "surrogateescape")


def to_bytes(text: str) -> bytes:
    """The bytes from which text was decoded. Other lone surrogates, which no bytes decode to, become question marks."""
    try:
        return text.encode("utf-8", "surrogateescape")
    except UnicodeEncodeError:
        return _OTHER_SURROGATES.sub("?", text).encode("utf-8", "surrogateescape")


def quoted(value: object) -> str:
    """An invalid value for an error message: its beginning, on one line."""
    text = readable(repr(value[:_QUOTED] if isinstance(value, str | bytes | list | tuple) else value))
    return text if len(text) <= _QUOTED else f"{text[: _QUOTED - 3]}..."


def unknown(kind: str, name: str, known: Iterable[str]) -> str:
    """Error message for a name that is not one of those known: the closest one, and all of them if they are few."""
    from difflib import get_close_matches  # only a mistake needs it

    names = list(known)
    close = get_close_matches(name.lower(), names, 1)
    if close and len(names) > _FEW:
        return f"unknown {kind} {quoted(name)}: did you mean {close[0]}?"
    hint = f"; did you mean {close[0]}?" if close else ""
    return f"unknown {kind} {quoted(name)}: choose one of {', '.join(names)}{hint}"


def readable(text: str) -> str:
    """Text that can be encoded in UTF-8: bytes that are not valid UTF-8 appear as ``\\xe9``."""
    return text if text.isascii() else text.encode("utf-8", READABLE).decode("utf-8")


def from_readable(text: str) -> str:
    """The inverse of `readable`. An escape that was typed in manually is also converted to the byte."""
    return _SHOWN_BYTE.sub(lambda match: chr(0xDC00 + int(match[1], 16)), text)


def readable_in(value: _Value) -> _Value:
    """A copy of a value of dicts, lists, tuples, dataclasses and scalars in which all text is readable."""
    return cast(_Value, _readable_in(value))


def _readable_in(value: Any) -> Any:
    if isinstance(value, str):
        return value if isinstance(value, Enum) else readable(value)
    if isinstance(value, dict):
        return {_readable_in(name): _readable_in(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_readable_in(item) for item in value]
    if type(value) is tuple:
        return tuple(_readable_in(item) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{f.name: _readable_in(getattr(value, f.name)) for f in fields(value) if f.init})
    return value


def show_any_text(*streams: TextIO) -> None:
    """Make these streams accept any text, even if they are a terminal with another encoding."""
    for stream in streams:
        if isinstance(stream, TextIOWrapper):  # a test may have replaced it by another type
            stream.reconfigure(errors=READABLE)


def _escaped(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(_escape, error.object[error.start : error.end])), error.end


def _escape(letter: str) -> str:
    if "\udc80" <= letter <= "\udcff":
        return f"\\x{ord(letter) - 0xDC00:02x}"
    return letter.encode("ascii", "backslashreplace").decode("ascii")


codecs.register_error(READABLE, _escaped)


def lower(text: str) -> str:
    """Convert to lower case, ASCII letters only: the Kelvin sign is not a k."""
    return from_bytes(to_bytes(text).lower())


def strip(text: str) -> str:
    """Remove the blanks at both ends."""
    return text.strip(BLANKS)


def lines(text: str) -> list[str]:
    """Split into lines, which end with LF, CR LF or CR; returned without these."""
    found = _LINE_BREAK.split(text)
    return found if found[-1] else found[:-1]


def words(text: str) -> list[str]:
    """Split at blanks."""
    return _WORD.findall(text)


def json_document(text: str | bytes) -> Any:
    """Parse a JSON document. Raises ValueError, also for brackets that are nested too deeply."""
    import json

    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def whole_number(text: str) -> int:
    """Parse an integer; blanks around it are allowed. Raises ValueError."""
    if not _WHOLE.fullmatch(strip(text)):
        raise ValueError(f"{text[:40]!r} is not a whole number")
    return int(text)


def number(text: str) -> float:
    """Parse a decimal number; blanks around it are allowed, ``inf`` and ``nan`` are not. Raises ValueError, also for
    numbers beyond 1.8e308."""
    if not _NUMBER.fullmatch(strip(text)):
        raise ValueError(f"{text[:40]!r} is not a number")
    value = float(strip(text))
    if value in (float("inf"), float("-inf")):
        raise ValueError(f"{text[:40]} is too large for a number")
    return value
