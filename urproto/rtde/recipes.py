"""Recipes: the ordered list of variables in a data package."""

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from urproto.compat import Self
from urproto.errors import LocalProtocolError, RemoteProtocolError
from urproto.rtde.fields import NOT_FOUND, WIRE_TYPES, Field
from urproto.versions import Availability


def type_names(names: Iterable[str], fields: Mapping[str, Field]) -> tuple[str, ...]:
    """The types for the reply to a set-up request; NOT_FOUND for an unknown name."""
    return tuple(fields[name].type.wire_name if name in fields else NOT_FOUND for name in names)


class RecipeValues(Mapping[str, Any]):
    """The values of a package by name, vectors as tuples.

    All numbers are decoded together, but a vector is only sliced out of them on access, because few of many variables
    are read in a control period.
    """

    __slots__ = ("_flat", "_places")

    def __init__(self, flat: tuple[Any, ...], places: Mapping[str, int | slice]) -> None:
        self._flat = flat
        self._places = places

    def __getitem__(self, name: str) -> Any:
        return self._flat[self._places[name]]

    def __contains__(self, name: object) -> bool:
        return name in self._places

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({dict(self)})"


class Recipe:
    """Packs and unpacks the data of one recipe, without the package header and recipe id."""

    def __init__(self, fields: Iterable[Field]) -> None:
        self.fields = tuple(fields)
        self._struct = struct.Struct(">" + "".join(field.type.layout for field in self.fields))
        self._places: dict[str, int | slice] = {}
        self._order: list[int | slice] = []  # like `_places`, but in order and with duplicate names
        offset = 0
        for field in self.fields:
            count = field.type.count
            self._order.append(offset if count == 1 else slice(offset, offset + count))
            self._places[field.name] = self._order[-1]
            offset += count

    @classmethod
    def of(cls, names: Iterable[str], fields: Mapping[str, Field]) -> Self:
        """The recipe for these names. Raises LocalProtocolError, which lists the names missing in ``fields``."""
        names = tuple(names)
        missing = [name for name in names if name not in fields]
        if missing:
            raise LocalProtocolError(f"no such RTDE variable: {', '.join(missing)}")
        return cls(fields[name] for name in names)

    @classmethod
    def of_reply(cls, names: Sequence[str], types: Sequence[str]) -> Self | None:
        """The recipe that a set-up reply describes; None if the robot refused a variable, or if its type is unknown."""
        if len(names) != len(types) or not WIRE_TYPES.keys() >= set(types):
            return None
        never = Availability(None, None, None)
        kinds = zip(names, map(WIRE_TYPES.__getitem__, types), strict=True)
        return cls(Field(name, kind, "", never, False, name, None, "") for name, kind in kinds)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the variables, in order."""
        return tuple(field.name for field in self.fields)

    @property
    def types(self) -> tuple[str, ...]:
        """Types of the variables as in a set-up reply, in order."""
        return tuple(field.type.wire_name for field in self.fields)

    @property
    def size(self) -> int:
        """Size of the data in bytes."""
        return self._struct.size

    def pack(self, values: Sequence[Any]) -> bytes:
        """Pack a value for each field; vectors are sequences.

        Raises LocalProtocolError when a value is missing or does not fit its type.
        """
        if len(values) != len(self.fields):
            raise LocalProtocolError(f"the recipe has {len(self.fields)} variables, not {len(values)}")
        flat: list[Any] = []
        for field, value in zip(self.fields, values, strict=True):
            flat.extend(value) if field.type.count > 1 else flat.append(value)
        try:
            return self._struct.pack(*flat)
        except (struct.error, OverflowError) as error:
            raise LocalProtocolError(f"values do not fit the recipe {','.join(self.names)}: {error}") from error

    def unpack(self, data: bytes) -> tuple[Any, ...]:
        """The values of a package, vectors as tuples. Raises RemoteProtocolError for a wrong size."""
        flat = self._numbers(data, 0)
        return tuple([flat[place] for place in self._order])

    def values(self, data: bytes, start: int = 0) -> RecipeValues:
        """The values of a package by name, from byte ``start`` on. Raises RemoteProtocolError for a wrong size."""
        return RecipeValues(self._numbers(data, start), self._places)

    def _numbers(self, data: bytes, start: int) -> tuple[Any, ...]:
        if len(data) - start != self._struct.size:
            raise RemoteProtocolError(f"the recipe needs {self._struct.size} bytes of data, not {len(data) - start}")
        return self._struct.unpack_from(data, start)

    def packer(self, head: bytes = b"") -> Callable[[Any], bytes]:
        """A function that converts a snapshot to ``head`` followed by the packed data, for every control period.

        A single generated expression reads all attributes, in a third of the time of a loop over the fields. The names
        in it come from the field table, never from the wire.
        """
        arguments = ", ".join(field.expression for field in self.fields)
        pack: Callable[[Any], bytes] = eval(
            f"lambda s: head + pack({arguments})", {"head": head, "pack": self._struct.pack}
        )
        return pack
