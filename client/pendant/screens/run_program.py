"""The program that runs or is loaded: its tree, or its script with the line that is carried out."""

from collections.abc import Callable
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.programs import ShownProgram
from client.pendant.screens.run_editor import replace_draft
from client.pendant.station import Station

__all__ = ["build_program"]

_UNTOLD: Final = "Robots do not tell the text of their programs. A script sent from the editor is shown here."
_NOTHING: Final = "No program is loaded, and none runs."
_NOT_PLAYED: Final = "The script of a program tree is known once the program was played."


def build_program(page: Page, edit: Callable[[], object]) -> None:
    """Put it on the page. edit: show the editor, which got the text."""
    live = page.live
    form = ui.toggle({"tree": "Tree", "script": "Script"}, value="tree").props("dense no-caps unelevated")

    def shows_tree(shown: ShownProgram) -> bool:
        return bool(shown.tree) and form.value == "tree"

    with ui.row().classes("program-head"):
        form.move(ui.context.slot.parent)
        live.text(_where, "program-where").props("data-testid=program-where")
        ui.space()
        copy = ui.button("Edit a copy", icon="edit", on_click=lambda: _copy(page, edit))
        copy.props("flat no-caps data-testid=program-copy")
    live.effect(lambda s: bool(s.programs.shown.tree), form.set_visibility)
    live.effect(lambda s: bool(s.programs.shown.text) and not shows_tree(s.programs.shown), copy.set_visibility)
    live.text(lambda s: _note(s, shows_tree(s.programs.shown)), "program-note").props("data-testid=program-note")

    box = ui.element("div").classes("program-text").props("data-testid=program-text tabindex=0")
    live.bind(box, "value", _Content(page, shows_tree).read)
    marks = ui.element("span").classes("hidden")
    live.bind(marks, "value", lambda s: _marks(s, shows_tree(s.programs.shown)))
    ui.run_javascript(f"pendantRun.program({box.id}, {marks.id})")


class _Content:
    """What the box shows, made anew only when it is another; equal contents are the same object."""

    def __init__(self, page: Page, shows_tree: Callable[[ShownProgram], bool]) -> None:
        self._page = page
        self._shows_tree = shows_tree
        self._of: object = None
        self._content: dict[str, Any] = {}

    def read(self, station: Station) -> dict[str, Any]:
        shown = station.programs.shown
        tree = self._shows_tree(shown)
        if self._of != (shown, tree):
            self._of = (shown, tree)
            lines = [[node.number, node.depth, node.text, node.suppressed] for node in shown.tree] if tree else None
            self._content = {"tree": lines} if tree else {"text": shown.text}
        return self._content


def _marks(station: Station, tree: bool) -> list[int]:
    """Lines of the script, or numbers of nodes, that are carried out."""
    programs = station.programs
    if tree:
        return [thread.label_id for thread in programs.threads if thread.label_id] if programs.shown.running else []
    line = programs.line(station)
    return [line] if line else []


def _where(station: Station) -> str:
    """What each thread does, as its labels say."""
    return "   ".join(f"{thread.name}: {thread.label}" for thread in station.programs.threads if thread.label)


def _note(station: Station, tree: bool) -> str:
    shown = station.programs.shown
    if not station.connected:
        return station.situation.hint
    if not shown.text and not tree:
        if shown.tree:
            return _NOT_PLAYED
        return _NOTHING if station.behind.available else _UNTOLD
    if shown.running and not tree and not station.programs.tells_line(station):
        return f"PolyScope {station.version} does not tell which line is carried out; 3.14, 5.9 and later do."
    return ""


async def _copy(page: Page, edit: Callable[[], object]) -> None:
    if await replace_draft(page, page.station.programs.shown.text):
        edit()
