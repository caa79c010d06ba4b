"""Program: the tree of nodes of a program, which is edited, played, stepped through and shown in 3D here."""

import json
from collections.abc import Awaitable, Callable
from functools import partial
from pathlib import PurePosixPath
from typing import Any, Final

from nicegui import ui
from nicegui.elements.scene.scene_object3d import Object3D

from client.pendant import program_playback as playback
from client.pendant.arm_scene import arm_scene, camera_buttons
from client.pendant.page import Callback, Page
from client.pendant.program_draft import ProgramDraft, Selection
from client.pendant.program_view import palette
from client.pendant.screens.program_form import NodeForm
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.versions import PolyscopeVersion

_DROP_PLACES: Final = ("before", "onto", "after")  # where a node is dropped relative to another one
_BREAKPOINT: Final = "Breakpoint: the program pauses here (F9)"
_NOT_SAVED: Final = "A robot saves no files for others: download the program"
_WAYPOINT_RADIUS_M: Final = 0.012
_WAYPOINT_COLOR: Final = "#e08a00"
_SELECTED_COLOR: Final = "#2f7fb8"
_MAX_WAYPOINTS: Final = 300  # drawn waypoints; more would be unreadable


def build(page: Page) -> None:
    selection = Selection(page.station.program_draft)
    commands = Commands(page, selection)
    with ui.element("div").classes("program-screen"):
        _toolbar(page, commands)
        _palette(page, selection)
        tree = _tree_element()
        with ui.element("div").classes("program-side"):
            form = NodeForm(page, selection)
            program_scene(page, selection)
        _connect_tree(page, selection, commands, tree, form)
    page.live.on_message("drop", commands.drop)
    page.live.effect(
        lambda station: page.live.screen == "program" and playback.can_save_files(station),
        lambda visible: page.run_in_background(lambda: playback.load_installation(page.station)) if visible else None,
    )


class Commands:
    """The actions of buttons and keys on the selected node."""

    def __init__(self, page: Page, selection: Selection) -> None:
        self.page = page
        self._selection = selection
        self._draft: ProgramDraft = page.station.program_draft
        self._pick = page.picker(".urp", "program-file", self._open_uploaded, "a program")

    def handle(self, message: Any, form: NodeForm) -> None:
        """Run a command of the browser's tree: [name, id of a node]."""
        if not isinstance(message, list) or len(message) != 2 or not isinstance(message[0], str):
            return
        name, node = message
        if isinstance(node, str):
            self._selection.choose(node)
        if name == "edit":
            form.focus()
        elif (command := self.by_name.get(name)) is not None:
            self.page.run_in_background(command)

    def drop(self, message: Any) -> None:
        """Move a dragged node: [its id, the other's id, one of `_DROP_PLACES`]."""
        match message:
            case [str(node), str(at), str(place)] if place in _DROP_PLACES:
                self._selection.choose(node)
                self.page.run_in_background(lambda: self._draft.drop(node, at, place))

    @property
    def by_name(self) -> dict[str, Callback]:
        """The commands by their names in static/screen_program.js."""
        draft, node = self._draft, self._selection.node
        return {
            "save": self.save,
            "undo": draft.undo,
            "redo": draft.redo,
            "cut": self.cut,
            "copy": lambda: draft.copy(node),
            "paste": lambda: self._selection.choose(draft.paste(node)),
            "delete": self.delete,
            "up": lambda: draft.move_by(node, -1),
            "down": lambda: draft.move_by(node, 1),
            "suppress": lambda: draft.suppress(node),
            "breakpoint": self.breakpoint,
        }

    def run(self, name: str) -> object:
        return self.by_name[name]()

    def cut(self) -> None:
        self._draft.copy(self._selection.node)
        self.delete()

    def delete(self) -> None:
        """Delete the node and its children, and select its neighbour."""
        node = self._selection.node
        neighbour = self._draft.view.neighbour(node)
        self._draft.delete(node)
        self._selection.choose(neighbour)

    async def breakpoint(self) -> None:
        self._draft.toggle_breakpoint(self._selection.node)
        await playback.send_breakpoints(self.page.station)

    async def play(self) -> None:
        """Play from the start, or resume."""
        await self._start_program(lambda: playback.play(self.page.station))

    async def play_from(self) -> None:
        await self._start_program(lambda: playback.play(self.page.station, at=self._selection.node))

    async def step(self) -> None:
        await self._start_program(lambda: playback.step(self.page.station))

    async def _start_program(self, start: Callable[[], Awaitable[None]]) -> None:
        self.page.station.situation.require(Action.PLAY)
        if not self._draft.path and playback.can_play_files(self.page.station):
            await self.save()
            if not self._draft.path:
                return
        if await self.page.confirm_move():
            await start()

    # files

    async def _confirm_replacing(self) -> bool:
        """Whether the program may be replaced; the user is asked if changes would be lost."""
        draft = self._draft
        if not draft.changed:
            return True
        text = f"The changes to {draft.title} are not saved, and everybody here sees this program."
        return await self.page.confirm("Leave this program?", text, "Leave it")

    async def new(self) -> None:
        if await self._confirm_replacing():
            self._draft.new()

    async def open(self) -> None:
        """Open a file of the programs folder, or of the browser's machine."""
        page = self.page
        if not await self._confirm_replacing():
            return
        if not playback.can_save_files(page.station):
            self._pick()
            return
        names = [name for name in await page.station.programs.files(page.station) if name.endswith(playback.EXTENSION)]
        choice = await page.choose(
            "Open a program", names, "The programs folder has no .urp files.", "program-choice", "From this machine"
        )
        if choice:
            await playback.open_file(page.station, choice)
        elif choice == "":
            self._pick()

    def _open_uploaded(self, data: bytes, name: str) -> None:
        self._draft.open(data, PurePosixPath(name).name)

    async def save(self) -> None:
        """Save under the present name, or under one that the user enters."""
        if not self._draft.path:
            await self.save_as()
            return
        await playback.save(self.page.station, self._draft.path)
        self.page.show_message(f"{self._draft.path} is saved")

    async def save_as(self) -> None:
        page, draft = self.page, self._draft

        def field() -> ui.input:
            box = ui.input("Name", value=draft.path or "").props("autofocus outlined dense data-testid=program-name")
            return box.props('suffix=".urp"' if not draft.path else "")

        name = await page.request_value("Save the program as", field, "Save", "program-save-confirm")
        if name is None:
            return
        path = playback.with_extension(name)
        if path != draft.path and path in await page.station.programs.files(page.station):
            text = f"{path} is there already."
            if not await page.confirm("Replace the program?", text, "Replace it"):
                return
        await playback.save(page.station, path)
        page.show_message(f"{path} is saved")

    async def download(self) -> None:
        name = PurePosixPath(self._draft.path or "unnamed.urp").name
        ui.download(self._draft.data(), name)


def _toolbar(page: Page, commands: Commands) -> None:
    draft = page.station.program_draft

    def button(title: str, icon: str, command: Callback | None, test_id: str, hint: str = "") -> ui.button:
        new_button = ui.button(icon=icon, on_click=command).props(f'flat aria-label="{title}" data-testid={test_id}')
        with new_button:
            ui.tooltip(hint or title)
        return new_button

    def add_gap() -> None:
        ui.element("span").classes("program-gap")

    with ui.card().classes("panel program-bar").props('role=toolbar aria-label="Program"'):
        title = page.live.text(lambda _: draft.title, "program-title").props("data-testid=program-title")
        page.live.bind(title, "state", lambda _: "changed" if draft.changed else "saved")
        button("New", "note_add", page.handler(commands.new), "program-new")
        button("Open", "folder_open", page.handler(commands.open), "program-open")
        for save_button in (
            button("Save", "save", page.handler(commands.save), "program-save"),
            button("Save as", "save_as", page.handler(commands.save_as), "program-save-as"),
        ):
            page.live.effect(playback.can_save_files, save_button.set_enabled)
            page.live.bind(save_button, "title", lambda s: "" if playback.can_save_files(s) else _NOT_SAVED)
        button("Download", "download", page.handler(commands.download), "program-download")
        add_gap()
        undo = button("Undo", "undo", page.handler(draft.undo), "program-undo", "Undo (Ctrl+Z)")
        redo = button("Redo", "redo", page.handler(draft.redo), "program-redo", "Redo (Ctrl+Y)")
        page.live.effect(lambda _: draft.can_undo, undo.set_enabled)
        page.live.effect(lambda _: draft.can_redo, redo.set_enabled)
        add_gap()
        for name, text, icon, keys in (
            ("cut", "Cut", "content_cut", "Ctrl+X"),
            ("copy", "Copy", "content_copy", "Ctrl+C"),
            ("paste", "Paste", "content_paste", "Ctrl+V"),
            ("delete", "Delete", "delete", "Del"),
            ("suppress", "Suppress", "do_not_disturb_on", "Ctrl+E"),
            ("up", "Move up", "arrow_upward", "Alt+Up"),
            ("down", "Move down", "arrow_downward", "Alt+Down"),
        ):
            button(text, icon, page.handler(partial(commands.run, name)), f"program-{name}", f"{text} ({keys})")
        add_gap()
        _play_buttons(page, commands, button)


def _play_buttons(page: Page, commands: Commands, button: Callable[..., ui.button]) -> None:
    for text, icon, command, test_id, emulated in (
        ("Save and play from the start", "play_arrow", commands.play, "program-play", False),
        ("Play from selection", "playlist_play", commands.play_from, "program-play-from", False),
        ("Step to the next node", "skip_next", commands.step, "program-step", True),
    ):
        new_button = button(text, icon, None, test_id)
        page.bind_button(Action.PLAY, command, new_button, text)
        if emulated:
            page.live.effect(
                lambda s: playback.can_play_files(s) and s.situation.permits(Action.PLAY), new_button.set_enabled
            )
            page.live.bind(new_button, "title", playback.stepping_refusal)
    breakpoint_button = button(
        "Breakpoint", "stop_circle", page.handler(commands.breakpoint), "program-breakpoint", _BREAKPOINT
    )
    page.live.effect(playback.can_play_files, breakpoint_button.set_enabled)
    page.live.bind(breakpoint_button, "title", playback.stepping_refusal)
    page.live.text(lambda s: s.situation.play_refusal or playback.play_hint(s), "program-reason").props(
        "data-testid=program-reason"
    )


def _palette(page: Page, selection: Selection) -> None:
    """Types of nodes in the groups of PolyScope; a click inserts one after the selected node, or into it."""
    draft = page.station.program_draft

    async def insert(kind: str) -> None:
        await page.attempt(lambda: selection.choose(draft.insert(kind, selection.node)))

    box = ui.card().classes("panel program-palette").props('role=group aria-label="Nodes to insert"')

    def fill(version: PolyscopeVersion | None) -> None:
        box.clear()
        with box:
            for group, entries in palette(version).items():
                ui.label(group).classes("program-group")
                for entry in entries:
                    new_button = ui.button(entry.title, icon=entry.icon, on_click=lambda name=entry.name: insert(name))
                    new_button.props(f"flat dense no-caps data-testid=insert-{entry.name}").tooltip(entry.doc)

    page.live.effect(lambda s: s.version, fill)


def _tree_element() -> ui.element:
    with ui.card().classes("panel program-tree-panel"):
        box = ui.element("div").classes("program-tree")
        return box.props('role=tree aria-label="Program tree" data-testid=program-tree')


def _connect_tree(page: Page, selection: Selection, commands: Commands, tree: ui.element, form: NodeForm) -> None:
    """Show the program in the tree, and handle the commands of the tree.

    The commands arrive over the same connection as the content of the form's fields, and so after it: when another node
    is selected, the form already has the typed content, even before the field reports the loss of focus.
    """
    draft = page.station.program_draft
    page.live.bind(tree, "value", lambda _: draft.view.shown_rows())
    marks, selected = ui.element("span").classes("hidden"), ui.element("span").classes("hidden")
    page.live.bind(marks, "value", _running_numbers)
    page.live.bind(selected, "value", lambda _: selection.node)
    tree.on("treecommand", lambda event: commands.handle(event.args.get("detail"), form), ["detail"])
    ids = [tree.id, marks.id, selected.id, form.fields_id]
    ui.run_javascript(f"pendantProgram.tree({json.dumps(ids)[1:-1]})")


def _running_numbers(station: Station) -> list[int]:
    """Numbers of the nodes that are being executed, if this program is running."""
    threads = station.programs.threads
    if not threads or not playback.is_on_robot(station):
        return []
    return [thread.label_id for thread in threads if thread.label_id]


def program_scene(page: Page, selection: Selection) -> None:
    """Add the scene to the page. Lines between waypoints are straight, like those of MoveL."""
    with ui.card().classes("panel program-scene").props("data-testid=program-scene"):
        scene = arm_scene(page)
        camera_buttons(page, scene)
    spheres, lines = dict[str, Object3D](), list[Object3D]()

    def draw(waypoints: tuple[tuple[str, tuple[float, ...]], ...]) -> None:
        for drawn in (*spheres.values(), *lines):
            drawn.delete()
        spheres.clear()
        lines.clear()
        with scene:
            previous: tuple[float, ...] | None = None
            for node, position in waypoints[:_MAX_WAYPOINTS]:
                x, y, z = position
                spheres[node] = (
                    scene.sphere(_WAYPOINT_RADIUS_M)
                    .material(_WAYPOINT_COLOR)
                    .move(x, y, z)
                    .with_name(f"waypoint {node}")
                )
                if previous is not None:
                    lines.append(scene.line(list(previous), list(position)).material(_WAYPOINT_COLOR))
                previous = position
        highlight(selection.node)

    def highlight(selected: str) -> None:
        for node, sphere in spheres.items():
            color = _SELECTED_COLOR if node == selected else _WAYPOINT_COLOR
            if sphere.color != color:
                sphere.material(color)

    draft = page.station.program_draft
    page.live.effect(lambda _: draft.view.waypoints(), draw)
    page.live.effect(lambda _: selection.node, highlight)
