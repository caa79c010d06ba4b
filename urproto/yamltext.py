"""YAML that a person or another program wrote: plain data, or one error that says why not."""

import re
from collections.abc import Mapping
from typing import Any, Final

import yaml

_MOST_VALUES: Final = 1_000_000  # with aliases written out; a guess: no settings have so many
_DEEPEST: Final = 200  # brackets in brackets: each costs as much as there are around it (a guess: no settings need ten)


class NotYaml(ValueError):  # noqa: N818 - what the text is
    """The text is not YAML, or its aliases stand for more than any settings hold; one line says where and why."""


def load_yaml(text: bytes | str) -> Any:
    """The content of a document. Raises NotYaml; bytes are UTF-8."""
    try:
        text = text if isinstance(text, str) else text.decode("utf-8")
        if _depth(text) > _DEEPEST:
            raise RecursionError
        content = yaml.safe_load(text)
        size = _size(content, {})
    except RecursionError:
        raise NotYaml("it is nested too deeply") from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise NotYaml(" ".join(str(error).split())) from error
    except (ValueError, ArithmeticError, TypeError, AttributeError, LookupError) as error:
        # a date of the 99th day, a number with no digits: the loader's constructors let through any
        raise NotYaml(f"a value is not what it looks like: {error}") from error
    if size > _MOST_VALUES:
        raise NotYaml(f"its aliases stand for more than {_MOST_VALUES} values")
    return content


def _depth(text: str) -> int:
    """Most brackets that are open at once, wherever they stand."""
    depth = deepest = 0
    for bracket in re.findall(r"[\[\]{}]", text):
        depth = depth + 1 if bracket in "[{" else max(0, depth - 1)
        deepest = max(deepest, depth)
    return deepest


def _size(value: Any, known: dict[int, int]) -> int:
    """Values with aliases written out, each container counted once. Raises NotYaml for one that contains itself."""
    if not isinstance(value, Mapping | list | tuple | set):
        return 1
    size = known.get(id(value))
    if size == 0:
        raise NotYaml("an alias leads into itself")
    if size is None:
        known[id(value)] = 0
        size = 1 + sum(_size(item, known) for item in (value.values() if isinstance(value, Mapping) else value))
        known[id(value)] = size
    return size
