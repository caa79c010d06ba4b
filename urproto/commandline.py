"""What the command lines of all packages have in common."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import Enum
from functools import wraps
from importlib import import_module
from importlib.metadata import version as distribution_version
from inspect import Signature, signature
from math import isfinite
from typing import TYPE_CHECKING, Annotated, Any, Final, TextIO, TypeAlias

import typer
from typer.core import TyperCommand
from typer.main import get_command

from urproto.text import readable

if TYPE_CHECKING:
    from rich.console import Console


_UNWRAPPED: Final = 10_000  # columns of what is not a terminal: whoever reads a file or a pipe wants whole lines

AsJson: TypeAlias = Annotated[bool, typer.Option("--json", help="Print JSON instead, for programs.")]


def application(help: str | None = None, *, completion: bool = True, **options: Any) -> typer.Typer:  # noqa: A002
    """A Typer application whose help texts are plain ("[rad]" is a unit) and whose tracebacks are Python's."""
    return typer.Typer(
        help=help, add_completion=completion, pretty_exceptions_enable=False, rich_markup_mode=None, **options
    )


def version_of(program: str) -> Any:
    """What a flag ``--version`` of a program does and says: an option of Typer."""

    def show(wanted: bool) -> None:
        if wanted:
            typer.echo(f"{program} {distribution_version('ur-emulator')}")
            raise typer.Exit

    return typer.Option("--version", callback=show, is_eager=True, help="Show the version and exit.")


def with_options_of(
    function: Callable[..., Any], *, without: Sequence[str] = (), last: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Let a command have a function's parameters as options, before its own or as the last ones.

    The command gets them as a mapping, its first argument, to call the function with.
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
    """What a shell completes an argument to, found out only when it asks."""

    def complete(incomplete: str) -> list[str]:
        return [word for word in words() if word.startswith(incomplete)]

    return complete


def console(file: TextIO | None = None, *, stderr: bool = False) -> "Console":
    """Standard output, standard error or a file. Square brackets are no markup; lines wrap in a terminal only."""
    from rich.console import Console  # most commands print lines alone

    target = file or (sys.stderr if stderr else sys.stdout)
    width = None if target.isatty() else _UNWRAPPED
    return Console(file=file, stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


def print_json(value: Any) -> None:
    """A value on standard output, as `plain_json` makes it: on one line unless for a terminal."""
    typer.echo(json.dumps(plain_json(value), indent=2 if sys.stdout.isatty() else None))


def plain_json(value: Any) -> Any:
    """The value as JSON has it: enumerations by their names, numbers that JSON lacks (NaN, infinity) as null,
    text as people can read it."""
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
    """Stands for a command where commands are listed; its callback brings the command itself."""

    def load(self) -> Any:
        """The command itself."""
        assert self.callback is not None
        return self.callback()

    def make_context(self, *arguments: Any, **extra: Any) -> Any:
        """Of the command itself: this is where a command that was named on the command line begins."""
        return self.load().make_context(*arguments, **extra)


def load_from(place: str) -> Callable[[], Any]:
    """A callback for `Deferred`: the command of a function or of a Typer application, given as ``module:name``."""
    module, _, name = place.partition(":")

    def load() -> Any:
        found = getattr(import_module(module), name)
        if isinstance(found, typer.Typer):
            return get_command(found)
        alone = application(completion=False)
        alone.command()(found)
        return get_command(alone)

    return load
