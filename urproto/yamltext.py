"""YAML that a person or another program wrote: plain data, or one error that says why not."""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

_MOST_BYTES: Final = 500_000  # a guess: ten times the longest settings. PyYAML takes some ten seconds for as many
_MOST_VALUES: Final = 1_000_000  # with aliases written out; a guess: no settings have so many
_MOST_BITS: Final = 1023  # of a whole number: more than a float holds
_MOST_NESTED: Final = 50
"""Brackets in one another: PyYAML goes through all that are open at every word, so thousands of them take minutes."""


class NotYaml(ValueError):  # noqa: N818 - what the text is
    """The text is not YAML, or its aliases stand for more than any settings hold; one line says where and why."""


@cache
def _loader() -> Any:
    import yaml  # a robot starts without a file of that kind more often than with one

    class Loader(yaml.SafeLoader):
        def fetch_flow_collection_start(self, TokenClass: Any) -> None:
            if self.flow_level >= _MOST_NESTED:
                raise NotYaml("it is nested too deeply")
            super().fetch_flow_collection_start(TokenClass)

    return Loader


def load_yaml(text: bytes | str) -> Any:
    """The content of a document. Raises NotYaml; bytes are UTF-8."""
    import yaml

    if len(text) > _MOST_BYTES:
        raise NotYaml(f"it is longer than {_MOST_BYTES} bytes, which no settings are")
    try:
        content = yaml.load(text if isinstance(text, str) else text.decode("utf-8"), _loader())
        size = _size(content, {})
    except NotYaml:
        raise
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


def _size(value: Any, known: dict[int, int]) -> int:
    """Values with aliases written out, each container counted once. Raises NotYaml for one that contains itself."""
    if isinstance(value, int) and value.bit_length() > _MOST_BITS:
        raise NotYaml("a whole number is too large to compute with")
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
