"""What people write in files, such as YAML, as typed values: an error is one line that names the place.

Types are those of msgspec: dataclasses, its Struct, named tuples, tuples for lists of known length, Literal, Annotated.
"""

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    from msgspec import inspect

_T = TypeVar("_T")

_STEP: Final = re.compile(r"\.(\w+)|\[([^]]*)\]")
_TYPE: Final = re.compile("`([^`]*)`")
_WORDS: Final = {
    "array": "a list",
    "bool": "true or false",
    "float": "a number",
    "int": "a whole number",
    "null": "nothing",
    "object": "a mapping",
    "str": "text",
}


def converted(
    content: Any, kind: type[_T], where: object, error: Callable[[str], Exception] = ValueError, **options: Any
) -> _T:
    """``content``, of plain data, as a ``kind``. where: the file, or its part. options: those of `msgspec.convert`.

    Raises ``error``, such as "file.yaml: at[1] must be a number, not text".
    """
    import msgspec  # imported here because many commands read no such file

    try:
        found: _T = msgspec.convert(content, kind, **options)
    except msgspec.ValidationError as problem:
        raise error(f"{where}: {_described(str(problem), kind)}") from problem
    return found


def _described(text: str, kind: type[Any]) -> str:
    what, _, place = text.partition(" - at `$")
    place = place.rstrip("`")
    named = place.lstrip(".")
    subject = f"{named}: " if named else ""
    if what.startswith("Expected"):
        what = _TYPE.sub(lambda match: " or ".join(_WORDS.get(one, one) for one in match[1].split(" | ")), what)
        what = what.removeprefix("Expected ").replace(", got ", ", not ")
        return f"{named or 'it'} must be {what}"
    name = _TYPE.search(what)
    if name is not None and "missing" in what:
        return f"{subject}{name[1]} is missing"
    wrong = what.removeprefix("Object contains ").replace("Invalid enum value", "invalid value").replace("`", "'")
    allowed = ", ".join(_allowed(kind, place))
    return f"{subject}{wrong}" + (f"; allowed are {allowed}" if allowed else "")


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
