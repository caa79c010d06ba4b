"""Choosing what a diagram shows: usual groups, and a search in all that this robot has."""

from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.plots import Pane, Plots
from client.pendant.series import PRESETS, Series, catalogue

__all__ = ["Picker"]

_COLUMNS: Final[list[dict[str, Any]]] = [
    {"name": "label", "label": "Signal", "field": "label", "align": "left", "sortable": True},
    {"name": "unit", "label": "Unit", "field": "unit", "align": "left"},
    {"name": "doc", "label": "What it is", "field": "doc", "align": "left"},
]


class Picker:
    """A dialog over the page."""

    def __init__(self, page: Page, plots: Plots) -> None:
        self._page = page
        self._plots = plots
        self._pane = Pane()
        self._known = dict[str, Series]()
        with ui.dialog() as self._dialog, ui.card().classes("picker"):
            ui.label("Signals of this diagram").classes("text-subtitle1")
            with ui.row().classes("presets"):
                for name in PRESETS:
                    ui.button(name, on_click=lambda _, name=name: self._take(PRESETS[name])).props(
                        "outline no-caps dense"
                    ).props(f'data-testid="preset {name}"')
            search = ui.input(placeholder="Search, for example force, temperature, register_24").props(
                "dense outlined clearable autofocus data-testid=signal-search"
            )
            search.classes("w-full")
            self._table = ui.table(columns=_COLUMNS, rows=[], row_key="key", selection="multiple", pagination=0).props(
                "dense flat virtual-scroll hide-bottom"
            )
            self._table.classes("signals")
            self._table.bind_filter_from(search, "value", lambda text: text or "")
            with ui.row().classes("w-full items-center"):
                ui.button("None", on_click=lambda: self._select([])).props("flat no-caps data-testid=signals-none")
                ui.space()
                ui.button("Cancel", on_click=self._dialog.close).props("flat no-caps")
                ui.button("Show", on_click=self._done).props("no-caps data-testid=signals-show")

    def open(self, pane: Pane) -> None:
        """Let a person choose for a diagram."""
        self._pane = pane
        self._known = catalogue(self._page.station.version)
        self._table.rows = [
            {"key": key, "label": one.label, "unit": one.shown_unit, "doc": one.doc} for key, one in self._known.items()
        ]
        self._select([one.key for one in pane.series])
        self._dialog.open()

    def _select(self, keys: list[str]) -> None:
        self._table.selected = [row for row in self._table.rows if row["key"] in keys]

    async def _take(self, keys: tuple[str, ...]) -> None:
        await self._show([self._known[key] for key in keys if key in self._known])

    async def _done(self) -> None:
        wanted = {row["key"] for row in self._table.selected}
        await self._show([one for key, one in self._known.items() if key in wanted])

    async def _show(self, chosen: list[Series]) -> None:
        async def choose() -> None:
            self._plots.choose(self._pane, chosen)

        if await self._page.attempt(choose):
            self._dialog.close()
