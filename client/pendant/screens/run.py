"""Run: the loaded program and its state, its variables, its text or tree, and a script editor."""

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Final

from nicegui import ui

from client import dashboard
from client.pendant.page import Page
from client.pendant.programs import ShownProgram
from client.pendant.screens.run_editor import build_editor, replace_draft
from client.pendant.station import Station
from client.pendant.variables import VariablesView
from urproto.modes import RuntimeState

_TEXT_UNAVAILABLE: Final = (
    "Robots do not publish the text of their programs. A script sent from the editor is shown here."
)
_NO_PROGRAM: Final = "No program is loaded or running."
_NOT_PLAYED_YET: Final = "The script of a program tree is available once the program has been played."
_STATES = {RuntimeState.PLAYING: "good", RuntimeState.STOPPED: "", RuntimeState.PAUSED: "wait"}


def build_program(page: Page, edit: Callable[[], object]) -> None:
    """The view of the program. edit: shows the editor."""
    live = page.live
    form = ui.toggle({"tree": "Tree", "script": "Script"}, value="tree").props("dense no-caps unelevated")

    def shows_tree(shown: ShownProgram) -> bool:
        return bool(shown.tree) and form.value == "tree"

    with ui.row().classes("program-head"):
        form.move(ui.context.slot.parent)
        live.text(_thread_positions, "program-where").props("data-testid=program-where")
        ui.space()
        copy = ui.button("Edit a copy", icon="edit", on_click=lambda: _copy(page, edit))
        copy.props("flat no-caps data-testid=program-copy")
    live.effect(lambda s: bool(s.programs.shown.tree), form.set_visibility)
    live.effect(lambda s: bool(s.programs.shown.text) and not shows_tree(s.programs.shown), copy.set_visibility)
    live.text(lambda s: _note_text(s, shows_tree(s.programs.shown)), "program-note").props("data-testid=program-note")

    box = ui.element("div").classes("program-text").props("data-testid=program-text tabindex=0")
    live.bind(box, "value", _Content(page, shows_tree).read)
    marks = ui.element("span").classes("hidden")
    live.bind(marks, "value", lambda s: _marked_numbers(s, shows_tree(s.programs.shown)))
    ui.run_javascript(f"pendantRun.program({box.id}, {marks.id})")


class _Content:
    """The content of the box, replaced only if it changes; equal contents are the same object."""

    def __init__(self, page: Page, shows_tree: Callable[[ShownProgram], bool]) -> None:
        self._page = page
        self._shows_tree = shows_tree
        self._source: object = None
        self._content: dict[str, Any] = {}

    def read(self, station: Station) -> dict[str, Any]:
        shown = station.programs.shown
        tree = self._shows_tree(shown)
        if self._source != (shown, tree):
            self._source = (shown, tree)
            lines = [[node.number, node.depth, node.text, node.suppressed] for node in shown.tree] if tree else None
            self._content = {"tree": lines} if tree else {"text": shown.text}
        return self._content


def _marked_numbers(station: Station, tree: bool) -> list[int]:
    """Lines of the script, or numbers of nodes, that are being executed."""
    programs = station.programs
    if tree:
        return [thread.label_id for thread in programs.threads if thread.label_id] if programs.shown.running else []
    line = programs.current_line(station)
    return [line] if line else []


def _thread_positions(station: Station) -> str:
    return "   ".join(f"{thread.name}: {thread.label}" for thread in station.programs.threads if thread.label)


def _note_text(station: Station, tree: bool) -> str:
    shown = station.programs.shown
    if not station.connected:
        return station.situation.hint
    if not shown.text and not tree:
        if shown.tree:
            return _NOT_PLAYED_YET
        return _NO_PROGRAM if station.emulator.available else _TEXT_UNAVAILABLE
    if shown.running and not tree and not station.programs.reports_line(station):
        return f"PolyScope {station.version} does not report which line is being executed; 3.14, 5.9 and later do."
    return ""


async def _copy(page: Page, edit: Callable[[], object]) -> None:
    if await replace_draft(page, page.station.programs.shown.text):
        edit()


def build(page: Page) -> None:
    with ui.element("div").classes("run-screen"):
        with ui.column().classes("run-left"):
            _control_panel(page)
            _variables_panel(page)
        with ui.card().classes("panel run-right"):
            with ui.tabs().props("dense no-caps align=left").classes("run-tabs") as tabs:
                ui.tab("program", "Program").props("data-testid=run-tab-program")
                ui.tab("script", "Script editor").props("data-testid=run-tab-script")
            with ui.tab_panels(tabs, value="program", animated=False, keep_alive=True).classes("run-panels"):
                with ui.tab_panel("program").classes("run-panel"):
                    build_program(page, lambda: tabs.set_value("script"))
                with ui.tab_panel("script").classes("run-panel"):
                    build_editor(page)


# the loaded program


def _control_panel(page: Page) -> None:
    station = page.station
    with page.panel("Loaded program", "run-control"):
        page.live.text(_loaded_text, "run-loaded").props("data-testid=run-loaded")
        page.live.text(_run_time_text, "run-time").props("data-testid=run-time")
        page.live.text(lambda s: s.situation.play_refusal, "soft run-refusal").props("data-testid=run-refusal")
        with ui.row().classes("run-load"):
            box = ui.input(placeholder="Path below the programs folder").props("dense outlined data-testid=run-path")
            box.props('aria-label="Path of a program below the programs folder"')
            box.classes("run-path")
            choose = ui.button(icon="folder_open", on_click=page.handler(lambda: _choose(page, load))).props("flat")
            with choose.props('data-testid=run-choose aria-label="Programs of the emulator"'):
                ui.tooltip("Programs of the emulator")
            page.live.effect(lambda s: "programs" in s.emulator.verbs and s.emulator.available, choose.set_visibility)
            page.needs_robot(ui.button("Load", on_click=lambda: load(box.value or ""))).props(
                "data-testid=run-load unelevated"
            )
        with ui.row().classes("run-state"):
            state = page.live.text(lambda s: s.situation.program, "chip run-chip")
            page.live.bind(
                state.props("data-testid=run-state"), "state", lambda s: _STATES.get(s.runtime_state, "wait")
            )
            ui.space()
            page.program_buttons("", "run-")

    async def load(path: str) -> None:
        box.set_value(path)
        await page.attempt(partial(_load, station, path.strip()), f"{path.strip()} is loaded")


async def _load(station: Station, path: str) -> None:
    if not path:
        raise ValueError("give the path of a program below the robot's programs folder, for example job.urp")
    await station.mover.release_control()
    await station.request(dashboard.load(path))
    station.programs.refresh()


async def _choose(page: Page, load: Callable[[str], Awaitable[None]]) -> None:
    """A list of the emulator's programs; a click loads one."""
    names = await page.station.programs.files(page.station)
    empty = "The programs folder has no .urp or .script files."
    if chosen := await page.choose("Programs", names, empty, "run-file"):
        await load(chosen)


def _loaded_text(station: Station) -> str:
    if not station.connected:
        return "–"
    return station.programs.loaded or "No program is loaded"


def _run_time_text(station: Station) -> str:
    seconds = station.programs.run_time_s(station.values.get("timestamp", 0.0))
    if seconds is None or not station.connected:
        return ""
    whole_seconds = int(seconds)
    verb = "ran" if station.runtime_state is RuntimeState.STOPPED else "runs"
    clock = f"{whole_seconds // 3600:02}:{whole_seconds // 60 % 60:02}:{whole_seconds % 60:02}"
    return f"{station.programs.running or 'A program without a name'} {verb}, {clock}"


# variables


def _variables_panel(page: Page) -> None:
    view = VariablesView(page.station.variables)
    with page.panel("Variables", "run-variables"):
        box = ui.element("div").classes("variables").props("data-testid=variables tabindex=0")
        page.live.stream(box, "lines", view.next_update)
        ui.run_javascript(f"pendantRun.variables({box.id})")
