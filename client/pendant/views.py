"""Parts of a screen of which one is in view at a time."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Self

from nicegui import ui

from client.pendant.page import Page

__all__ = ["Views"]


class Views:
    """A row of buttons and what they show; ``name`` is that of the screen.

    on_look: told which view a person sees now, "" when it is none of these.
    """

    def __init__(self, page: Page, name: str, titles: Mapping[str, str]) -> None:
        self._page = page
        self._name = name
        self.shown = next(iter(titles))
        self.on_look: list[Callable[[str], None]] = []
        with ui.tabs().props("dense no-caps align=left inline-label").classes("views") as self._tabs:
            for key, title in titles.items():
                ui.tab(key, title).props(f"data-testid={name}-{key}")
        self._panels = ui.tab_panels(self._tabs, value=self.shown, animated=False).classes("view-panels")
        self._panels.on_value_change(lambda change: self._turn(change.value))
        page.live.on_show.append(lambda screen: self._tell())

    def __enter__(self) -> Self:
        self._panels.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._panels.__exit__(None, None, None)

    @contextmanager
    def view(self, key: str, classes: str = "") -> Iterator[None]:
        """What is put here is shown under this key."""
        with ui.tab_panel(key).classes(f"view {classes}"):
            yield

    @property
    def looked_at(self) -> str:
        """Which view a person sees now."""
        return self.shown if self._page.live.screen == self._name else ""

    def _turn(self, key: str) -> None:
        self.shown = key
        self._tell()

    def _tell(self) -> None:
        for tell in self.on_look:
            tell(self.looked_at)
