"""What people and programs write in files, such as YAML, as plain or typed values: an error is one line with the place.

Types are those of msgspec: dataclasses, its Struct, named tuples, tuples for lists of known length, Literal, Annotated.
"""

import re
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    from msgspec import inspect


_T = TypeVar("_T")

_STEP: Final = re.compile(r"\.(\w+)|\[([^]]*)\]")
_PLACE: Final = re.compile(r"(.*) - at (`key` in )?`\$(.*)`", re.DOTALL)
_MISSING: Final = re.compile("Object missing required field `(.*)`")
_WRONG: Final = re.compile("(?:Object contains unknown field|Invalid enum value) [`'](.*)[`']")
_TYPE: Final = re.compile("`([^`]*)`")
_WORDS: Final = {
    "Path": "a path",
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "null": "nothing",
    "object": "a mapping",
    "str": "text",
}

_MAX_BYTES: Final = 500_000  # a guess: ten times the longest settings. PyYAML takes some ten seconds for this many
_MAX_VALUES: Final = 1_000_000  # with aliases expanded; a guess: more than any settings have
_MAX_BITS: Final = 1023  # of an integer: beyond the range of a float
_MAX_DEPTH: Final = 50
"""Nesting of brackets: PyYAML iterates over all open ones at every word, so thousands of them take minutes."""


def converted(
    content: Any, kind: type[_T], where: object, error: Callable[[str], Exception] = ValueError, **options: Any
) -> _T:
    """``content``, of plain data, as a ``kind``. where: the file or its part, or "". options: of `msgspec.convert`.

    Raises ``error``, such as "file.yaml: at[1] must be a number, not text". Infinity and NaN are refused, too.
    """
    import msgspec  # imported here because many commands read no such file

    try:
        found: _T = msgspec.convert(content, kind, **options)
    except msgspec.ValidationError as problem:
        raise error(_described(str(problem), kind, str(where))) from problem
    if (place := next(_endless(content), None)) is not None:
        raise error(f"{_subject(where, place)} must be a finite number")
    return found


def _subject(where: object, place: str) -> str:
    return f"{where}{place}" if place.startswith("[") else ": ".join(filter(None, (str(where), place))) or "it"


def _endless(content: Any, place: str = "") -> Iterator[str]:
    """The places of numbers that are not finite: NaN passes the checks of bounds."""
    if isinstance(content, dict):
        for name, value in content.items():
            yield from _endless(value, f"{place}.{name}" if place else str(name))
    elif isinstance(content, list | tuple):
        for index, value in enumerate(content):
            yield from _endless(value, f"{place}[{index}]")
    elif isinstance(content, float) and not isfinite(content):
        yield place


def _described(text: str, kind: type[Any], where: str) -> str:
    what, is_key, place = match.groups() if (match := _PLACE.fullmatch(text)) else (text, None, "")
    subject = _subject(where, f"{'a name in ' if is_key else ''}{place.lstrip('.')}")
    if what.startswith("Expected"):
        what = _TYPE.sub(_in_words, what.removeprefix("Expected ")).replace(", got ", ", not ")
        return f"{subject} must be {what}"
    prefix = f"{subject}: " if where or place else ""
    if (missing := _MISSING.fullmatch(what)) is not None:
        return f"{prefix}{missing[1]} is missing"
    if (wrong := _WRONG.fullmatch(what)) is not None:
        return f"{prefix}unknown {wrong[1]!r}; allowed are {', '.join(_allowed(kind, place))}"
    return f"{prefix}{what}"


def _in_words(types: re.Match[str]) -> str:
    names = [name for name in types[1].split(" | ") if name != "null"] or ["null"]
    return " or ".join(_WORDS.get(name, name) for name in names)


def _allowed(kind: type[Any], place: str) -> Iterator[str]:
    """The keys or words that a document of this kind may have at a place."""
    from msgspec.inspect import EnumType, LiteralType, type_info

    found = [type_info(kind)]
    for name, index in _STEP.findall(place):
        found = [inner for outer in found for inner in _inside(outer, name, index)]
    for one in [inner for outer in found for inner in getattr(outer, "types", (outer,))]:
        if isinstance(one, EnumType):
            yield from (str(member.value) for member in one.cls)
        elif isinstance(one, LiteralType):
            yield from map(str, one.values)
        yield from (field.encode_name for field in getattr(one, "fields", ()))


def _inside(outer: "inspect.Type", name: str, index: str) -> Iterator["inspect.Type"]:
    """The types of a field or an element."""
    for one in getattr(outer, "types", (outer,)):
        if name:
            yield from (field.type for field in getattr(one, "fields", ()) if field.encode_name == name)
        elif (items := getattr(one, "item_types", None)) is not None:
            yield items[int(index)]
        else:
            yield from filter(None, (getattr(one, "item_type", None), getattr(one, "value_type", None)))


class InvalidYamlError(ValueError):
    """The text is not YAML, or its aliases expand to too many values; the message is one line with place and reason."""


@cache
def _loader() -> Any:
    import yaml  # imported here because most robots start without a YAML file

    class Loader(yaml.SafeLoader):
        def fetch_flow_collection_start(self, TokenClass: Any) -> None:
            if self.flow_level >= _MAX_DEPTH:
                raise InvalidYamlError("it is nested too deeply")
            super().fetch_flow_collection_start(TokenClass)

    return Loader


def load_yaml(text: bytes | str) -> Any:
    """Parse a document; bytes are UTF-8. Raises InvalidYamlError."""
    import yaml

    if len(text) > _MAX_BYTES:
        raise InvalidYamlError(f"it is longer than {_MAX_BYTES} bytes")
    try:
        content = yaml.load(text if isinstance(text, str) else text.decode("utf-8"), _loader())
        size = _size(content, {})
    except InvalidYamlError:
        raise
    except RecursionError:
        raise InvalidYamlError("it is nested too deeply") from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise InvalidYamlError(" ".join(str(error).split())) from error
    except (ValueError, ArithmeticError, TypeError, AttributeError, LookupError) as error:
        # such as a date with day 99, or a number without digits: the loader's constructors raise any exception
        raise InvalidYamlError(f"a value is not what it looks like: {error}") from error
    if size > _MAX_VALUES:
        raise InvalidYamlError(f"its aliases expand to more than {_MAX_VALUES} values")
    return content


def _size(value: Any, known: dict[int, int]) -> int:
    """The number of values with aliases expanded. Computed once a container. Raises InvalidYamlError for recursion."""
    if isinstance(value, int) and value.bit_length() > _MAX_BITS:
        raise InvalidYamlError("a whole number is too large to compute with")
    if not isinstance(value, Mapping | list | tuple | set):
        return 1
    size = known.get(id(value))
    if size == 0:
        raise InvalidYamlError("an alias contains itself")
    if size is None:
        known[id(value)] = 0
        size = 1 + sum(_size(item, known) for item in (value.values() if isinstance(value, Mapping) else value))
        known[id(value)] = size
    return size
