"""What a client asks of an RTDE connection: lists of variables, and what was last written to them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from urproto.errors import LocalProtocolError
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe

__all__ = ["InputRecipes", "Names", "read_recipe", "unknown_fields", "variable_names"]

Names = Sequence[str] | Path  # variables, or a file that lists them

_CLOSE_NAMES = 5  # told to who wrote a wrong one
_MASK = "_mask"  # these choose what the same package changes, so they are not kept from one write to the next


def read_recipe(path: Path) -> tuple[str, ...]:
    """The variables of a file with one name a line. Blank lines and what follows a ``#`` do not count.

    Raises OSError when the file cannot be read and LocalProtocolError when it is no list of names.
    """
    lines = (line.partition("#")[0].strip() for line in path.read_text("utf-8-sig").splitlines())
    names = tuple(line for line in lines if line)
    odd = [name for name in names if not name.isidentifier()]
    if odd:
        raise LocalProtocolError(f"{path}: {odd[0]!r} is no variable: give one name a line")
    if not names:
        raise LocalProtocolError(f"{path} names no variable")
    return names


def variable_names(names: Names) -> tuple[str, ...]:
    """The variables, read from their file if need be."""
    if isinstance(names, str):
        raise LocalProtocolError(f"a recipe is a list of names or the Path of a file, not the text {names!r}")
    return read_recipe(names) if isinstance(names, Path) else tuple(names)


def unknown_fields(names: Iterable[str]) -> str | None:
    """What is wrong with the names of outputs, and what may have been meant; None when nothing is."""
    for name in names:
        if name not in OUTPUT_FIELDS:
            close = get_close_matches(name, OUTPUT_FIELDS, _CLOSE_NAMES, 0.5)
            hint = f"did you mean {', '.join(close)}?" if close else "docs/supported.md lists them"
            return f"no RTDE output is called {name!r}: {hint}"
    return None


class InputRecipes:
    """The input recipes of one connection, and the values last written to each variable.

    A variable that was never written counts as 0, false or zeros. Masks are 0 in every
    package that does not name them: it leaves alone what they guard.
    """

    def __init__(self, recipes: Iterable[Names]) -> None:
        self.recipes = [Recipe.of(variable_names(names), INPUT_FIELDS) for names in recipes]
        self._last: dict[str, Any] = {}

    def add(self, names: Names) -> Recipe:
        """One more."""
        self.recipes.append(Recipe.of(variable_names(names), INPUT_FIELDS))
        return self.recipes[-1]

    def exactly(self, names: Collection[str]) -> int:
        """Index of the recipe that has exactly these variables. Raises LocalProtocolError."""
        for index, recipe in enumerate(self.recipes):
            if set(recipe.names) == set(names):
                return index
        raise LocalProtocolError(f"no input recipe has exactly the variables {', '.join(sorted(names))}")

    def covering(self, names: Collection[str]) -> list[int]:
        """Indices of few recipes that have all these variables: one if possible. Raises LocalProtocolError."""
        left, chosen = set(names), list[int]()
        while left:
            best = max(range(len(self.recipes)), key=lambda index: self._worth(index, left), default=0)
            if not self.recipes or left.isdisjoint(self.recipes[best].names):
                raise LocalProtocolError(f"no input recipe has {', '.join(sorted(left))}: name it when connecting")
            chosen.append(best)
            left -= set(self.recipes[best].names)
        return chosen

    def _worth(self, index: int, wanted: set[str]) -> tuple[int, int]:
        """Most of the wanted variables first, then the fewest others."""
        names = self.recipes[index].names
        return len(wanted.intersection(names)), -len(names)

    def pack(self, index: int, values: Mapping[str, Any]) -> bytes:
        """The data of a recipe: these values, and the last ones of its other variables.

        Raises LocalProtocolError for a value that does not fit; then nothing is remembered.
        """
        recipe = self.recipes[index]
        current = {field.name: self._value(field.name, field.type.count, values) for field in recipe.fields}
        data = recipe.pack([current[name] for name in recipe.names])
        self._last.update(current)
        return data

    def _value(self, name: str, count: int, values: Mapping[str, Any]) -> Any:
        nothing = 0 if count == 1 else (0,) * count
        return values.get(name, nothing if name.endswith(_MASK) else self._last.get(name, nothing))
