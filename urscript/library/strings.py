"""Strings (Script Manual, module internals). A string is a sequence of bytes; see `urscript.values`."""

import math
import re
import sys

from urproto.text import BLANKS, from_bytes, to_bytes
from urscript.builtins import Library
from urscript.errors import RuntimeFault
from urscript.meter import charge
from urscript.values import INT_MAX, INT_MIN, MAX_STRING, Any_, Int, Str, as_string, to_text

LIBRARY = Library("strings")

_NUMBER = re.compile(
    r"[ \t\r\n\f\v]*([+-]?)(0[xX][0-9a-fA-F]+|[0-9]+\.?[0-9]*(?:[eE][+-]?[0-9]+)?|\.[0-9]+(?:[eE][+-]?[0-9]+)?)"
)
_LONGEST_INT = 400  # digits, more than any number in range has
_SHORT_INT = 10  # digits, all of which are in range
_DECIMAL = re.compile(r"-?[0-9]{1,12}\.[0-9]{1,12}").fullmatch
_SHORT_DECIMAL = 16  # characters
_SHORT = 64  # bytes, which take no time to search
_SPECIAL = re.compile(r"[ \t\r\n\f\v]*([+-]?)(inf|infinity|nan)\Z", re.IGNORECASE)


_BYTES_A_UNIT = 16  # per unit of work, for operations on a whole string


def _slice(text: str, start: int, stop: int) -> str:
    """Bytes `start` to `stop` of a string."""
    return text[start:stop] if text.isascii() else from_bytes(_bytes(text)[start:stop])


def _length(text: str) -> int:
    return len(text) if text.isascii() else len(_bytes(text))


def _bytes(text: str) -> bytes:
    """The bytes of a string; charges the work, because the string may be a long literal."""
    charge(len(text) // _BYTES_A_UNIT)
    return to_bytes(text)


@LIBRARY.builtin(cb3="3.8", e="5.2")
def str_at(src: Str, index: Int) -> str:
    """The byte at `index` (from 0) as a string; a runtime error outside the string."""
    if src.isascii() and 0 <= index < len(src):
        return src[index]
    if not 0 <= index < _length(src):
        raise RuntimeFault(f"str_at: index {index} is outside a string of {_length(src)} bytes")
    return _slice(src, index, index + 1)


@LIBRARY.builtin(cb3="3.8", e="5.2")
def str_cat(op1: Any_, op2: Any_) -> str:
    """The texts of two values, one after the other; a runtime error beyond 1023 bytes."""
    left = op1 if op1.__class__ is str else to_text(op1)
    return as_string(left + (op2 if op2.__class__ is str else to_text(op2)))


@LIBRARY.builtin(cb3="3.8", e="5.2")
def str_empty(str_: Str) -> bool:
    """True for the empty string."""
    return not str_


@LIBRARY.builtin(cb3="3.8", e="5.2")
def str_find(src: Str, target: Str, start_from: Int = 0) -> int:
    """Index of the first `target` in `src` at or after `start_from`, -1 when there is none."""
    if src.isascii() and len(src) < _SHORT and start_from >= 0:  # the usual case
        return src.find(target, start_from)
    if start_from < 0:
        raise RuntimeFault(f"str_find: start_from must not be negative, it is {start_from}")
    return _bytes(src).find(_bytes(target), start_from)


@LIBRARY.builtin(cb3="3.8", e="5.2")
def str_len(str_: Str) -> int:
    """Number of bytes of a string."""
    return _length(str_)


@LIBRARY.builtin(cb3="3.8", e="5.2", aliases={"length": "len"})
def str_sub(src: Str, index: Int, length: Int | None = None) -> str:
    """`length` bytes of `src` from `index`, or all the rest; fewer when the string ends before.

    A runtime error when `index` is outside 0..str_len(src) or the length is negative.
    """
    if index >= 0 and src.isascii():  # the usual case
        if length is None:
            if index <= len(src):
                return src[index:]
        elif length >= 0 and index <= len(src):
            return src[index : index + length]
    if not 0 <= index <= _length(src):
        raise RuntimeFault(f"str_sub: index {index} is outside a string of {_length(src)} bytes")
    if length is not None and length < 0:
        raise RuntimeFault(f"str_sub: the length must not be negative, it is {length}")
    return _slice(src, index, MAX_STRING + index if length is None else index + length)


@LIBRARY.builtin(cb3="3.8", e="5.2")
def to_num(str_: Str) -> float:
    """The number at the beginning of a string: an int, or a float when it has a '.' or an exponent.

    Leading blanks, a sign, 0x, INF and NAN are accepted. Anything else is a runtime error, as is an int beyond 32 bits
    or a number too large for a float.
    """
    if "." in str_:  # the usual cases
        if len(str_) < _SHORT_DECIMAL and not str_.strip("+-.0123456789"):
            try:
                return float(str_)
            except ValueError:
                pass
    elif len(str_) < _SHORT_INT and str_.isdigit() and str_.isascii():
        return int(str_)
    if _DECIMAL(str_):
        return float(str_)
    charge(len(str_) // _BYTES_A_UNIT)
    special = _SPECIAL.match(str_)
    if special:
        return math.copysign(float(special[2]), -1.0 if special[1] == "-" else 1.0)
    match = _NUMBER.match(str_)
    if not match or str_[match.end() :].strip(BLANKS):
        raise RuntimeFault(f'to_num: "{str_[:40]}" is not a number')
    sign = -1 if match[1] == "-" else 1
    digits = match[2]
    if digits[:2] in ("0x", "0X"):
        return _within_range(str_, sign * int(digits, 16), INT_MIN, INT_MAX)
    if digits.isdigit():
        return _within_range(str_, sign * int(digits[:_LONGEST_INT]), INT_MIN, INT_MAX)
    return _within_range(str_, sign * float(digits), -sys.float_info.max, sys.float_info.max)


def _within_range(text: str, value: float, least: float, most: float) -> float:
    if not least <= value <= most:
        raise RuntimeFault(f'to_num: "{text[:40]}" is out of range')
    return value


@LIBRARY.builtin(cb3="3.8", e="5.2")
def to_str(val: Any_) -> str:
    """The text of a value."""
    return to_text(val)
