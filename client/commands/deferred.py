"""Commands that are loaded when they are called, so that a command costs what it needs and not what all others need."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

__all__ = ["Deferred", "load_from"]


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
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        alone.command()(found)
        return get_command(alone)

    return load
