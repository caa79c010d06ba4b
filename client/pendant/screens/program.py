"""Program: the tree of nodes of a program, which is edited, played, stepped through and shown in 3D here."""

import json
from collections.abc import Awaitable, Callable
from typing import Any, Final

from nicegui import ui

from client.pendant import program_playing as playing
from client.pendant.page import Page
from client.pendant.program_draft import ProgramDraft, Selection
from client.pendant.program_view import palette
from client.pendant.screens.program_files import FileButtons
from client.pendant.screens.program_form import NodeForm
from client.pendant.screens.program_scene import program_scene
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.versions import PolyscopeVersion

_PLACES: Final = ("before", "onto", "after")  # where a node is dropped at another one
_BREAKPOINT: Final = "Breakpoint: the program pauses here (F9)"


def build(page: Page) -> None:
    """Put it on the page."""
    selection = Selection(page.station.program_draft)
    deeds = Deeds(page, selection)
    with ui.element("div").classes("program-screen"):
        _bar(page, deeds)
        _palette(page, selection)
        tree = _tree()
        with ui.element("div").classes("program-side"):
            form = NodeForm(page, selection)
            program_scene(page, selection)
        _follow(page, selection, deeds, tree, form)
    page.live.hear("drop", deeds.drop)
    page.live.effect(
        lambda station: page.live.screen == "program" and playing.saves_here(station),
        lambda seen: page.soon(lambda: playing.take_installation(page.station)) if seen else None,
    )


class Deeds:
    """The actions of buttons and keys on the selected node."""

    def __init__(self, page: Page, selection: Selection) -> None:
        self.page = page
        self._selection = selection
        self._draft: ProgramDraft = page.station.program_draft
        self.save: Callable[[], Awaitable[object]] = _nothing

    def hear(self, said: Any, form: NodeForm) -> None:
        """What the browser says of its tree: [word, id of a node]."""
        if not isinstance(said, list) or len(said) != 2 or not isinstance(said[0], str):
            return
        word, node = said
        if isinstance(node, str):
            self._selection.choose(node)
        if word == "edit":
            form.focus()
        elif word == "save":
            self.page.soon(self.save)
        elif (deed := self.by_word.get(word)) is not None:
            self.page.soon(deed)

    def drop(self, said: Any) -> None:
        """A node that was dragged: [its id, the other's, one of `_PLACES`]."""
        match said:
            case [str(node), str(at), str(place)] if place in _PLACES:
                self._selection.choose(node)
                self.page.soon(lambda: self._drop(node, at, place))

    async def _drop(self, node: str, at: str, place: str) -> None:
        self._draft.drop(node, at, place)

    @property
    def by_word(self) -> dict[str, Callable[[], Awaitable[None]]]:
        """By the words of static/screen_program.js."""
        return {
            "undo": self.undo,
            "redo": self.redo,
            "cut": self.cut,
            "copy": self.copy,
            "paste": self.paste,
            "delete": self.delete,
            "up": self.up,
            "down": self.down,
            "suppress": self.suppress,
            "breakpoint": self.breakpoint,
        }

    async def undo(self) -> None:
        """The last change, whoever made it."""
        self._draft.undo()

    async def redo(self) -> None:
        """What was undone last."""
        self._draft.redo()

    async def cut(self) -> None:
        """Into the clipboard of the station."""
        self._draft.copy(self._selection.node)
        await self.delete()

    async def copy(self) -> None:
        """Into the clipboard of the station."""
        self._draft.copy(self._selection.node)

    async def paste(self) -> None:
        """Behind the selected node, or into it."""
        self._selection.choose(self._draft.paste(self._selection.node))

    async def delete(self) -> None:
        """With all below it; its neighbour is selected then."""
        node = self._selection.node
        beside = self._draft.view.neighbour(node)
        self._draft.delete(node)
        self._selection.choose(beside)

    async def up(self) -> None:
        """Before the node above it."""
        self._draft.shift(self._selection.node, -1)

    async def down(self) -> None:
        """Behind the node below it."""
        self._draft.shift(self._selection.node, 1)

    async def suppress(self) -> None:
        """Or not any more."""
        self._draft.suppress(self._selection.node)

    async def breakpoint(self) -> None:
        """Or none any more."""
        self._draft.toggle_breakpoint(self._selection.node)
        await playing.tell_breakpoints(self.page.station)

    async def play(self) -> None:
        """From the start, or on from where it is paused."""
        await self._start(lambda: playing.play(self.page.station))

    async def play_from(self) -> None:
        """From the selected node."""
        await self._start(lambda: playing.play(self.page.station, at=self._selection.node))

    async def step(self) -> None:
        """To the next node."""
        await self._start(lambda: playing.step(self.page.station))

    async def _start(self, start: Callable[[], Awaitable[None]]) -> None:
        self.page.station.situation.require(Action.PLAY)
        if not self._draft.path and playing.plays_files(self.page.station):
            await self.save()
            if not self._draft.path:
                return
        if await self.page.may_move():
            await start()


async def _nothing() -> None:
    """Before the toolbar is there."""


def _bar(page: Page, deeds: Deeds) -> None:
    """The toolbar: files, editing, playing."""
    draft = page.station.program_draft

    def button(
        title: str, icon: str, deed: Callable[[], Awaitable[None]] | None, mark: str, hint: str = ""
    ) -> ui.button:
        made = ui.button(icon=icon, on_click=deed).props(f'flat aria-label="{title}" data-testid={mark}')
        with made:
            ui.tooltip(hint or title)
        return made

    def gap() -> None:
        ui.element("span").classes("program-gap")

    with ui.card().classes("panel program-bar").props('role=toolbar aria-label="Program"'):
        title = page.live.text(lambda _: draft.title, "program-title").props("data-testid=program-title")
        page.live.bind(title, "state", lambda _: "changed" if draft.changed else "saved")
        files = FileButtons(page, button)
        deeds.save = files.save
        gap()
        undo = button("Undo", "undo", page.doing(deeds.undo), "program-undo", "Undo (Ctrl+Z)")
        redo = button("Redo", "redo", page.doing(deeds.redo), "program-redo", "Redo (Ctrl+Y)")
        page.live.effect(lambda _: draft.can_undo, undo.set_enabled)
        page.live.effect(lambda _: draft.can_redo, redo.set_enabled)
        gap()
        for word, text, icon, keys in (
            ("cut", "Cut", "content_cut", "Ctrl+X"),
            ("copy", "Copy", "content_copy", "Ctrl+C"),
            ("paste", "Paste", "content_paste", "Ctrl+V"),
            ("delete", "Delete", "delete", "Del"),
            ("suppress", "Suppress", "do_not_disturb_on", "Ctrl+E"),
            ("up", "Move up", "arrow_upward", "Alt+Up"),
            ("down", "Move down", "arrow_downward", "Alt+Down"),
        ):
            button(text, icon, page.doing(deeds.by_word[word]), f"program-{word}", f"{text} ({keys})")
        gap()
        _play_buttons(page, deeds, button)


def _play_buttons(page: Page, deeds: Deeds, button: Callable[..., ui.button]) -> None:
    for text, icon, deed, mark, emulated in (
        ("Save and play from the start", "play_arrow", deeds.play, "program-play", False),
        ("Play from selection", "playlist_play", deeds.play_from, "program-play-from", False),
        ("Step to the next node", "skip_next", deeds.step, "program-step", True),
    ):
        made = button(text, icon, None, mark)
        page.button_for(Action.PLAY, deed, made, text)
        if emulated:
            page.live.effect(_may_step, made.set_enabled)
            page.live.bind(made, "title", playing.why_not_by_node)
    halt = button("Breakpoint", "stop_circle", page.doing(deeds.breakpoint), "program-breakpoint", _BREAKPOINT)
    page.live.effect(playing.plays_files, halt.set_enabled)
    page.live.bind(halt, "title", playing.why_not_by_node)
    page.live.text(_why_not, "program-why").props("data-testid=program-why")


def _may_step(station: Station) -> bool:
    return playing.plays_files(station) and station.situation.may(Action.PLAY)


def _why_not(station: Station) -> str:
    now = station.situation
    return playing.note(station) if now.may(Action.PLAY) or now.may(Action.PAUSE) else now.why_not(Action.PLAY)


def _palette(page: Page, selection: Selection) -> None:
    """Types of nodes in the groups of PolyScope; a click inserts one behind the selected node, or into it."""
    draft = page.station.program_draft

    async def insert(kind: str) -> None:
        async def put() -> None:
            selection.choose(draft.insert(kind, selection.node))

        await page.attempt(put)

    with ui.card().classes("panel program-palette").props('role=group aria-label="Nodes to insert"') as box:
        pass

    def fill(version: PolyscopeVersion | None) -> None:
        box.clear()
        with box:
            for group, entries in palette(version).items():
                ui.label(group).classes("program-group")
                for entry in entries:
                    made = ui.button(entry.title, icon=entry.icon, on_click=lambda name=entry.name: insert(name))
                    made.props(f"flat dense no-caps data-testid=insert-{entry.name}").tooltip(entry.doc)

    page.live.effect(lambda s: s.version, fill)


def _tree() -> ui.element:
    with ui.card().classes("panel program-tree-panel"):
        box = ui.element("div").classes("program-tree")
        return box.props('role=tree aria-label="Program tree" data-testid=program-tree')


def _follow(page: Page, selection: Selection, deeds: Deeds, tree: ui.element, form: NodeForm) -> None:
    """Let the tree show the program, and hear what is done in it.

    What the tree says comes over the connection of the form's fields, and so behind what was typed there before: the
    form has it when another node is selected, even before it hears that the field has lost the focus.
    """
    draft = page.station.program_draft
    page.live.bind(tree, "value", lambda _: draft.view.shown_rows())
    marks, chosen = ui.element("span").classes("hidden"), ui.element("span").classes("hidden")
    page.live.bind(marks, "value", _running)
    page.live.bind(chosen, "value", lambda _: selection.node)
    tree.on("said", lambda event: deeds.hear(event.args.get("detail"), form), ["detail"])
    ids = [tree.id, marks.id, chosen.id, form.fields_id]
    ui.run_javascript(f"pendantProgram.tree({json.dumps(ids)[1:-1]})")


def _running(station: Station) -> list[int]:
    """Numbers of the nodes that are carried out, if it is this program that runs."""
    threads = station.programs.threads
    if not threads or not playing.is_on_robot(station):
        return []
    return [thread.label_id for thread in threads if thread.label_id]
