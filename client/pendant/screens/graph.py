"""Graph: live diagrams of any RTDE outputs, with pause, cursor and export."""

from datetime import datetime
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.plots import MAX_PANES, PRESETS, RATES_HZ, WINDOWS_S, Pane, Plots, Series, catalogue
from client.pendant.station import Station

_COLUMNS: Final[list[dict[str, Any]]] = [
    {"name": "label", "label": "Signal", "field": "label", "align": "left", "sortable": True},
    {"name": "unit", "label": "Unit", "field": "unit", "align": "left"},
    {"name": "doc", "label": "What it is", "field": "doc", "align": "left"},
]


_CHECKBOX: Final = '<q-checkbox v-model="props.selected" :aria-label="{name}" />'


class SignalPicker:
    """A dialog over the page, in which signals are selected."""

    def __init__(self, page: Page, plots: Plots) -> None:
        self._page = page
        self._plots = plots
        self._pane = Pane()
        self._catalogue = dict[str, Series]()
        with ui.dialog() as self._dialog, ui.card().classes("picker"):
            ui.label("Signals of this diagram").classes("text-subtitle1")
            with ui.row().classes("presets"):
                for name in PRESETS:
                    ui.button(name, on_click=lambda _, name=name: self._select_preset(PRESETS[name])).props(
                        "outline no-caps dense"
                    ).props(f'data-testid="preset {name}"')
            search = ui.input(placeholder="Search, for example force, temperature, register_24").props(
                "dense outlined clearable autofocus data-testid=signal-search aria-label=Search"
            )
            search.classes("w-full")
            self._table = ui.table(columns=_COLUMNS, rows=[], row_key="key", selection="multiple", pagination=0).props(
                "dense flat virtual-scroll hide-bottom"
            )
            self._table.classes("signals")
            self._table.add_slot("header-selection", _CHECKBOX.format(name="'All signals'"))
            self._table.add_slot("body-selection", _CHECKBOX.format(name="props.row.label"))
            self._table.bind_filter_from(search, "value", lambda text: text or "")
            with ui.row().classes("w-full items-center"):
                ui.button("None", on_click=lambda: self._select([])).props("flat no-caps data-testid=signals-none")
                ui.space()
                ui.button("Cancel", on_click=self._dialog.close).props("flat no-caps")
                ui.button("Show", on_click=self._show_selected).props("no-caps data-testid=signals-show")

    def open(self, pane: Pane) -> None:
        """Let the user choose the signals of a diagram."""
        self._pane = pane
        self._catalogue = catalogue(self._page.station.version)
        self._table.rows = [
            {"key": key, "label": signal.label, "unit": signal.shown_unit, "doc": signal.doc}
            for key, signal in self._catalogue.items()
        ]
        self._select([signal.key for signal in pane.series])
        self._dialog.open()

    def _select(self, keys: list[str]) -> None:
        self._table.selected = [row for row in self._table.rows if row["key"] in keys]

    async def _select_preset(self, keys: tuple[str, ...]) -> None:
        await self._show([self._catalogue[key] for key in keys if key in self._catalogue])

    async def _show_selected(self) -> None:
        selected_keys = {row["key"] for row in self._table.selected}
        await self._show([signal for key, signal in self._catalogue.items() if key in selected_keys])

    async def _show(self, chosen: list[Series]) -> None:
        if await self._page.attempt(lambda: self._plots.choose(self._pane, chosen)):
            self._dialog.close()


def build(page: Page) -> None:
    screen = _Graph(page)
    page.live.on_show.append(screen.on_screen_change)
    page.on_close.append(lambda: screen.plots.hide(closing=True))


class _Graph:
    def __init__(self, page: Page) -> None:
        self.page = page
        self.plots = Plots(page.station.feeds)
        self.picker = SignalPicker(page, self.plots)
        self._cached_configuration: tuple[int, Any] = (-1, None)
        self._elements: list[tuple[Pane, int, int]] = []  # ids of legend and canvas
        with ui.column().classes("graph") as root:
            with ui.row().classes("graph-bar"):
                self._build_toolbar()
            self._panes = ui.column().classes("panes")
        self._build_panes()
        self._root = root
        page.live.bind(root, "plot", self._configuration)
        page.live.stream(root, "samples", self.plots.next_update)

    def on_screen_change(self, screen: str) -> None:
        if screen == "graph":
            self.plots.show()
        else:
            self.plots.hide()

    # controls

    def _build_toolbar(self) -> None:
        plots = self.plots
        for name, unit, choices in (("window_s", "s", WINDOWS_S), ("rate_hz", "Hz", RATES_HZ)):
            labels = {value: f"{value} {unit}" if value == choices[-1] else str(value) for value in choices}
            self._toggle(name, labels)
        self._toggle("si", {False: "°, mm", True: "SI"})
        self._pause = ui.button("Pause", icon="pause", on_click=self._toggle_pause).props(
            "unelevated no-caps data-testid=graph-pause"
        )
        ui.button("Clear", icon="delete_sweep", on_click=plots.clear).props("flat no-caps data-testid=graph-clear")
        self._add = ui.button("Diagram", icon="add", on_click=self._add_pane).props("flat no-caps data-testid=add-pane")
        ui.space()
        self.page.live.text(self._collected_text, "soft").props("data-testid=collected")
        ui.button("CSV", icon="download", on_click=self._save_csv).props("flat no-caps data-testid=csv")
        ui.button("PNG", icon="image").props("flat no-caps data-testid=png").on(
            "click", js_handler="() => pendant.savePlots()"
        )

    def _toggle(self, name: str, labels: dict[Any, str]) -> None:
        toggle = ui.toggle(labels, value=getattr(self.plots, name)).classes("graph-choice")
        toggle.props(f"dense no-caps unelevated data-testid={name}")
        toggle.on_value_change(lambda change: self._set(name, change.value))

    def _set(self, name: str, value: Any) -> None:
        setattr(self.plots, name, value)
        self.plots.changed()

    def _toggle_pause(self) -> None:
        self._set("paused", not self.plots.paused)
        self._pause.set_text("Resume" if self.plots.paused else "Pause")
        self._pause.props(f"icon={'play_arrow' if self.plots.paused else 'pause'}")

    def _collected_text(self, station: Station) -> str:
        feed = self.plots.feed
        if feed is None:
            return ""
        return feed.problem or f"{self.plots.count} states at {feed.rate_hz:g} Hz"

    async def _save_csv(self) -> None:
        async def save() -> None:
            ui.download.content(await self.plots.csv(), f"{self._file_name()}.csv", "text/csv")

        with self._root:
            await self.page.attempt(save)

    def _file_name(self) -> str:
        model = self.page.station.model
        return f"{model.name if model else 'robot'}-{datetime.now():%Y%m%d-%H%M%S}"

    # diagrams

    def _add_pane(self) -> None:
        pane = Pane()
        self.plots.panes.append(pane)
        self._build_panes()
        self.picker.open(pane)

    def _remove(self, pane: Pane) -> None:
        self.plots.panes.remove(pane)
        self._build_panes()

    def _build_panes(self) -> None:
        self._panes.clear()
        self._elements = []
        with self._panes:
            for number, pane in enumerate(self.plots.panes):
                self._build_pane(number, pane)
        self._add.set_enabled(len(self.plots.panes) < MAX_PANES)
        self.plots.changed()

    def _build_pane(self, number: int, pane: Pane) -> None:
        with ui.element("div").classes("panel pane").props(f"data-testid=pane-{number}"):
            with ui.element("div").classes("pane-head"):
                legend = ui.element("div").classes("legend")
                ui.button(icon="tune", on_click=lambda: self.picker.open(pane)).props(
                    f'flat dense round data-testid=choose-{number} aria-label="Choose signals of diagram {number + 1}"'
                ).tooltip("Choose signals")
                self._range_button(pane, number)
                if len(self.plots.panes) > 1:
                    ui.button(icon="close", on_click=lambda: self._remove(pane)).props(
                        f'flat dense round data-testid=remove-{number} aria-label="Remove diagram {number + 1}"'
                    ).tooltip("Remove this diagram")
            canvas = ui.element("canvas").classes("plot")
        self._elements.append((pane, legend.id, canvas.id))

    def _range_button(self, pane: Pane, number: int) -> None:
        def toggle() -> None:
            pane.auto = not pane.auto
            button.props(f"icon={'height' if pane.auto else 'lock'}")
            self.plots.changed()

        button = ui.button(icon="height" if pane.auto else "lock", on_click=toggle)
        button.props(f'flat dense round data-testid=auto-{number} aria-label="Range of diagram {number + 1}"')
        button.tooltip("Range: follows the signals, or stays")

    def _configuration(self, station: Station) -> Any:
        plots = self.plots
        if self._cached_configuration[0] != plots.version:
            self._cached_configuration = (plots.version, self._describe())
        return self._cached_configuration[1]

    def _describe(self) -> dict[str, Any]:
        plots = self.plots
        panes = [
            {
                "legend": legend,
                "canvas": canvas,
                "auto": pane.auto,
                "series": [
                    {
                        "key": signal.key,
                        "label": signal.label,
                        "unit": signal.unit if plots.si else signal.shown_unit,
                        "factor": 1.0 if plots.si else signal.factor,
                        "steps": signal.steps,
                    }
                    for signal in pane.series
                ],
            }
            for pane, legend, canvas in self._elements
        ]
        return {"panes": panes, "window": plots.window_s, "paused": plots.paused, "name": self._file_name()}
