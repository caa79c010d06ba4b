"""Log: events with their severity and the text of their code."""

from collections.abc import Callable, Iterable
from datetime import datetime
from typing import Final

from nicegui import ui

from client.pendant.events import MAX_SHOWN, SEVERITIES, Event, LogView, Severity, as_csv, as_text
from client.pendant.page import Page
from client.pendant.traces import OPENED, opened_files, page_of_run
from urproto.text import to_bytes

_ICONS: Final[dict[Severity, str]] = {"info": "info", "warning": "warning", "error": "error"}
_MOST_MB: Final = 64  # of a file that is opened; guess: more than any journal in memory
_HEADERS: Final = ("Time", "Uptime [s]", "", "Source", "Code", "Text")


def build(page: Page) -> None:
    view = LogView(page.station.log)
    with page.panel("Log", "log-panel"):
        with ui.row().classes("log-tools"):
            for severity in SEVERITIES:
                _severity_button(view, severity)
            _filter_field(view)
            ui.space()
            page.live.text(lambda station: f"{view.pending} new" if view.pending else "", "log-waiting")
            _pause_button(view)
            _tool_button("clear_all", "Clear view", view.clear, "log-clear")
            _tool_button("description", "Download as text", lambda: _download(view, as_text, "txt"), "log-text")
            _tool_button("table_view", "Download as CSV", lambda: _download(view, as_csv, "csv"), "log-csv")
            _trace_button(page)
            _open_button(page)
        _lines(page, view)


def _lines(page: Page, view: LogView) -> None:
    with ui.element("div").classes("log-head log-line"):
        for title in _HEADERS:
            ui.element("span").props(f'data-title="{title}"')
    box = ui.element("div").classes("log-lines").props("data-testid=log-lines tabindex=0")
    page.live.stream(box, "lines", view.next_update)
    ui.run_javascript(f"pendantLog.show({box.id}, {MAX_SHOWN})")


def _severity_button(view: LogView, severity: Severity) -> None:
    def toggle() -> None:
        view.severities ^= {severity}
        button.classes(toggle="log-off")

    button = ui.button(severity.capitalize(), icon=_ICONS[severity], color=None, on_click=toggle)
    button.props(f"no-caps unelevated data-testid=log-{severity}").classes(f"log-filter {severity}")


def _filter_field(view: LogView) -> None:
    box = ui.input(placeholder="Filter").props(
        "dense outlined clearable debounce=200 data-testid=log-words aria-label=Filter"
    )
    box.classes("log-words")
    with box.add_slot("prepend"):
        ui.icon("search")

    def change() -> None:
        view.words = box.value or ""

    box.on_value_change(change)


def _pause_button(view: LogView) -> None:
    def toggle() -> None:
        view.paused = not view.paused
        button.props(f"icon={'play_arrow' if view.paused else 'pause'}")
        hint.set_text("Resume" if view.paused else "Pause")

    button = ui.button(icon="pause", on_click=toggle).props('flat round data-testid=log-pause aria-label="Pause"')
    with button:
        hint = ui.tooltip("Pause")


def _tool_button(icon: str, hint: str, click: Callable[[], object], test_id: str) -> ui.button:
    with ui.button(icon=icon, on_click=click).props(f'flat round data-testid={test_id} aria-label="{hint}"') as button:
        ui.tooltip(hint)
    return button


def _trace_button(page: Page) -> None:
    async def download() -> None:
        page.show_message("The run is executed again; its page will be downloaded.")
        ui.download.content(await page_of_run(page.station), f"{_file_name('robot_run')}.html", "text/html")

    button = _tool_button("movie", "Download the run as a page", page.handler(download), "log-trace")
    page.show_if(button, lambda station: station.emulator.available and "journal" in station.emulator.verbs)


def _open_button(page: Page) -> None:
    link = ui.link("", new_tab=True).props("data-testid=log-opened")
    link.set_visibility(False)

    async def show(content: bytes, name: str) -> None:
        page.show_message("The page of the file is created.")
        link.props["href"] = await opened_files.open(content, name)
        link.set_text(f"Show {name}")
        link.set_visibility(True)

    choose = page.picker(",".join(OPENED), "log-file", show, "A journal or a recording", _MOST_MB)
    _tool_button("folder_open", "Open a journal or a recording", choose, "log-open")


def _file_name(what: str) -> str:
    return f"{what}_{datetime.now():%Y-%m-%d_%H-%M-%S}"


def _download(view: LogView, format_events: Callable[[Iterable[Event]], str], extension: str) -> None:
    ui.download(to_bytes(format_events(view.matching())), f"{_file_name('robot_log')}.{extension}")
