"""Load YAML written by a person or another program: as plain data, or with one error that gives the reason."""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

_MAX_BYTES: Final = 500_000  # a guess: ten times the longest settings. PyYAML takes some ten seconds for this many
_MAX_VALUES: Final = 1_000_000  # with aliases expanded; a guess: more than any settings have
_MAX_BITS: Final = 1023  # of an integer: beyond the range of a float
_MAX_DEPTH: Final = 50
"""Nesting of brackets: PyYAML iterates over all open ones at every word, so thousands of them take minutes."""


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
