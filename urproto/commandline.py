"""Helpers shared by the command lines of all packages."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from functools import wraps
from importlib import import_module
from importlib.metadata import version as distribution_version
from inspect import Signature, signature
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, Final, NoReturn, TextIO, TypeAlias

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from urproto.entry import USAGE_ERROR
from urproto.text import readable

if TYPE_CHECKING:
    from rich.console import Console


_UNWRAPPED: Final = 10_000  # columns if the output is not a terminal, so that lines in files and pipes are not wrapped

AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON instead, for programs.")]


class Commands(TyperGroup):
    """A group of commands whose list shows the first sentence of each completely, on several lines if necessary."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the list of commands for ``--help``."""
        found = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [(name, one.get_short_help_str(_UNWRAPPED)) for name, one in found if one is not None and not one.hidden]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


def application(help: str | None = None, *, completion: bool = True, **options: Any) -> typer.Typer:  # noqa: A002
    """A Typer application whose help texts are plain ("[rad]" is a unit) and whose tracebacks are Python's."""
    return typer.Typer(
        cls=Commands,
        help=help,
        add_completion=completion,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        **options,
    )


def version_of(program: str) -> Any:
    """The Typer option ``--version`` of a program."""

    def show(requested: bool) -> None:
        if requested:
            typer.echo(f"{program} {distribution_version('ur-emulator')}")
            raise typer.Exit

    return typer.Option("--version", callback=show, is_eager=True, help="Show the version and exit.")


def fail(program: str, problem: object, status: int = USAGE_ERROR) -> NoReturn:
    """End a command with a line on standard error."""
    typer.echo(f"{program}: {problem}", err=True)
    raise typer.Exit(status)


def with_options_of(
    function: Callable[..., Any], *, without: Sequence[str] = (), last: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorator that gives a command the parameters of a function as options, before its own or after them.

    The command receives them as a mapping in its first argument, with which it calls the function.
    """
    shared = {name: option for name, option in signature(function).parameters.items() if name not in without}

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        _, *own = signature(command).parameters.values()

        @wraps(command)
        def run(**given: Any) -> None:
            command({name: given.pop(name) for name in shared}, **given)

        order = [*own, *shared.values()] if last else [*shared.values(), *own]
        run.__signature__ = Signature(order)  # type: ignore[attr-defined]
        return run

    return decorate


def completing(words: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Shell completion of an argument; the words are only computed on request."""

    def complete(incomplete: str) -> list[str]:
        return [word for word in words() if word.startswith(incomplete)]

    return complete


def console(file: TextIO | None = None) -> "Console":
    """A console for standard output or a file.

    Square brackets are not markup, and lines are wrapped only in a terminal.
    """
    from rich.console import Console  # imported here because most commands only print lines

    width = None if (file or sys.stdout).isatty() else _UNWRAPPED
    return Console(file=file, width=width, highlight=False, markup=False, emoji=False)


def print_json(value: Any) -> None:
    """Print the result of `plain_json` for a value; on one line unless standard output is a terminal."""
    typer.echo(json.dumps(plain_json(value), indent=2 if sys.stdout.isatty() else None))


def plain_json(value: Any) -> Any:
    """Convert a value for JSON: enumerations to their names, numbers that JSON lacks (NaN, infinity) to null, and text
    to readable Unicode."""
    if isinstance(value, Mapping):
        return {readable(str(name)): plain_json(one) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(one) for one in value]
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, str):
        return readable(value)
    if isinstance(value, float) and not isfinite(value):
        return None
    return value


class Deferred(TyperCommand):
    """A placeholder for a command in lists of commands; its callback imports the command itself."""

    def load(self) -> Any:
        """The command itself."""
        assert self.callback is not None
        return self.callback()

    def make_context(self, *arguments: Any, **extra: Any) -> Any:
        """Create the context of the command itself; Click calls this for a command named on the command line."""
        return self.load().make_context(*arguments, **extra)


def load_from(place: str) -> Callable[[], Any]:
    """A callback for `Deferred` that imports a function or Typer application, given as ``module:name``."""
    module, _, name = place.partition(":")

    def load() -> Any:
        found = getattr(import_module(module), name)
        if isinstance(found, typer.Typer):
            return get_command(found)
        alone = application(completion=False)
        alone.command()(found)
        return get_command(alone)

    return load
