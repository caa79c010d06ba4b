"""The page of one browser: the frame around the screens, and functions that all screens share."""

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import isawaitable
from typing import Any, Final, TypeVar

from nicegui import background_tasks, ui
from nicegui.elements.mixins.disableable_element import DisableableElement
from nicegui.elements.mixins.value_element import ValueElement
from nicegui.events import UploadEventArguments

from client import dashboard
from client.errors import ClientError
from client.pendant.live import Live
from client.pendant.situation import Action, NotPermittedError
from client.pendant.station import Station
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.modes import RuntimeState
from urproto.text import readable

_ACCEPT_TIMEOUT_S: Final = 1.5  # guess: states and answers arrive within a tenth of this
EXPECTED_ERRORS: Final = (URError, OSError, ValueError)
"""Errors of robots and inputs, whose texts are meant for users."""


class NotAcceptedError(ClientError):
    """The robot accepted a command without an error, but did not carry it out."""


def bind_choice(
    page: "Page",
    element: ui.select | ui.toggle,
    read: Callable[[Station], Any],
    choose: Callable[[Any], Awaitable[Any]],
    label: str,
) -> None:
    """Bind an input element to a setting of the robot in both directions. label: name of the setting in errors."""
    station = page.station

    async def apply() -> None:
        target = element.value
        if not await page.attempt(
            lambda: send_and_verify(station, lambda: choose(target), lambda s: read(s) == target, f"{label} {target}")
        ):
            element.set_value(read(station))

    element.on("update:model-value", apply)
    page.live.effect(read, element.set_value)
    page.needs_robot(element)


async def send_and_verify(
    station: Station, send: Callable[[], Awaitable[Any]], accepted: Callable[[Station], bool], label: str
) -> None:
    """Send a command and wait until the robot has accepted it. Raises NotAcceptedError, and what ``send`` raises."""
    first_event = station.log.count
    await send()
    if not await wait_until(station, accepted):
        errors = [event.text for event in station.log.since(first_event) if event.severity == "error"]
        reason = f"it says: {'; '.join(errors)}" if errors else "is it in local control, or without power?"
        raise NotAcceptedError(f"the robot did not accept {label}: {reason}")


async def wait_until(station: Station, condition: Callable[[Station], bool]) -> bool:
    """Wait for a condition; returns False if it does not become true in time."""
    try:
        async with timeout(_ACCEPT_TIMEOUT_S):
            while not condition(station):
                await station.next_frame()
    except TimeoutError:
        return False
    return True


class Views:
    """Tabs with their panels. name: name of the screen.

    on_view_change: called with the view that becomes visible, "" if none of them is.
    """

    def __init__(self, page: "Page", name: str, titles: Mapping[str, str]) -> None:
        self._page = page
        self._name = name
        self.shown = next(iter(titles))
        self.on_view_change: list[Callable[[str], None]] = []
        with ui.tabs().props("dense no-caps align=left inline-label").classes("views") as self._tabs:
            for key, title in titles.items():
                ui.tab(key, title).props(f"data-testid={name}-{key}")
        self._panels = ui.tab_panels(self._tabs, value=self.shown, animated=False).classes("view-panels")
        self._panels.on_value_change(lambda change: self._show(change.value))
        page.live.on_show.append(lambda screen: self._notify())

    def __enter__(self) -> Self:
        self._panels.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._panels.__exit__(None, None, None)

    @contextmanager
    def view(self, key: str, classes: str = "") -> Iterator[None]:
        """A context in which the view of a key is built."""
        with ui.tab_panel(key).classes(f"view {classes}"):
            yield

    @property
    def visible_view(self) -> str:
        """The visible view, "" while another screen is shown."""
        return self.shown if self._page.live.screen == self._name else ""

    def _show(self, key: str) -> None:
        self.shown = key
        self._notify()

    def _notify(self) -> None:
        for callback in self.on_view_change:
            callback(self.visible_view)


Control = TypeVar("Control", bound=DisableableElement)
Callback = Callable[[], object]  # may return an awaitable


class Page:
    """The page of one browser, passed to every screen that builds a part of it.

    station: the robot, shared by all pages. live: the live values. content: the parent of dialogues, which do not
    belong to a screen. confirmed: the user has agreed that this page may move a real arm. on_close: called when the
    browser has disconnected.
    """

    def __init__(self, station: Station, live: Live) -> None:
        self.station = station
        self.live = live
        self.confirmed = False
        self.on_close: list[Callable[[], None]] = []
        self.content = ui.context.client.content
        station.mover.on_error.append(self.show_error)
        live.on_held.append(self._stop_on_release)

    def close(self) -> None:
        """The browser has disconnected for good."""
        self.station.mover.on_error.remove(self.show_error)
        self.live.close()
        for end in self.on_close:
            end()

    # notifications

    def show_error(self, text: str) -> None:
        """Show an error until a user has confirmed it."""
        with self.content:
            ui.notify(text, type="negative", multi_line=True, close_button="OK", timeout=10_000, position="top")

    def show_message(self, text: str) -> None:
        """Show a message for a moment."""
        with self.content:
            ui.notify(text, type="positive", timeout=2_000, position="top")

    # actions

    async def attempt(self, action: Callback, done: str = "") -> bool:
        """Run an action and show its error, or the text ``done``. Returns True on success."""
        try:
            result = action()
            if isawaitable(result):
                await result
        except EXPECTED_ERRORS as error:
            self.show_error(readable(str(error)))
            return False
        if done:
            self.show_message(done)
        return True

    def handler(self, action: Callback, done: str = "") -> Callable[[], Awaitable[None]]:
        """An event handler that attempts an action.

        Example: ``ui.button("Off", on_click=page.handler(lambda: station.request(dashboard.POWER_OFF)))``.
        """

        async def click() -> None:
            await self.attempt(action, done)

        return click

    def run_in_background(self, action: Callback) -> None:
        """Start an action from synchronous code; errors are shown."""
        background_tasks.create(self.attempt(action))

    async def play(self) -> None:
        """Start or resume the program; the pendant's control program is ended first."""
        station = self.station
        station.situation.require(Action.PLAY)
        if not await self.confirm_move():
            return
        if station.mover.in_control:
            await station.mover.release_control()
        await station.request(dashboard.PLAY)

    async def stop(self) -> None:
        """Stop the program of any client, and thereby the arm."""
        mover = self.station.mover
        if mover.in_control:
            await mover.stop()
        await self.station.request(dashboard.STOP)

    async def switch_simulation(self) -> None:
        """Toggle the switch between Simulation and Real Robot."""
        station, on = self.station, not self.station.simulating
        if station.mover.in_control:
            await station.mover.release_control()
            await wait_until(station, lambda s: s.runtime_state is RuntimeState.STOPPED)
        if station.runtime_state is not RuntimeState.STOPPED:
            raise NotPermittedError("A program runs: stop it before you switch between simulation and the real robot.")
        label = "simulation" if on else "the real robot"
        await send_and_verify(
            station, lambda: station.set_simulation(on), lambda s: s.simulating is on, f"the switch to {label}"
        )

    @property
    def move_confirmed(self) -> bool:
        """Whether the arm may be moved from here without asking the user."""
        return self.station.emulator.available or self.station.simulating or self.confirmed

    async def confirm_move(self) -> bool:
        """Whether the arm may be moved from here. For a real robot, the user has to agree once per page."""
        if self.move_confirmed:
            return True
        text = f"The arm at {self.station.robot_ip} is going to move. Is its workspace clear?"
        self.confirmed = await self.confirm("This is a real robot", text, "It may move", "confirm-move")
        return self.confirmed

    async def confirm(self, title: str, text: str, yes: str, test_id: str = "agree") -> bool:
        """Ask the user of this browser. test_id: of the button that agrees."""
        with self._question(title) as dialog:
            ui.label(text)
            _answers(dialog, yes, lambda: True, test_id)
        return bool(await dialog)

    async def request_value(
        self, title: str, add_field: Callable[[], ValueElement[Any]], yes: str, test_id: str
    ) -> Any:
        """Ask the user for the value of a field; None if cancelled. test_id: of the button that submits it."""
        with self._question(title) as dialog:
            field = add_field()
            field.on("keydown.enter", lambda: dialog.submit(field.value))
            _answers(dialog, yes, lambda: field.value, test_id)
        return await dialog

    async def choose(self, title: str, names: Sequence[str], empty: str, test_id: str, other: str = "") -> str | None:
        """Let the user choose a name; None if cancelled. empty: a text without names. other: a button that gives ""."""
        with self._question(title, "run-files") as dialog:
            if not names:
                ui.label(empty)
            with ui.list().props("dense separator").classes("run-file-list"):
                for name in names:
                    ui.item(name, on_click=lambda name=name: dialog.submit(name)).props(f"data-testid={test_id}")
            _answers(dialog, other, lambda: "", f"{test_id}-other")
        answer: str | None = await dialog
        return answer

    @contextmanager
    def _question(self, title: str, classes: str = "") -> Iterator[ui.dialog]:
        with self.content, ui.dialog() as dialog, ui.card().classes(classes):
            ui.label(title).classes("text-h6")
            yield dialog
            dialog.on("hide", dialog.delete)  # if it is deleted earlier, its backdrop may stay

    def _stop_on_release(self, held: Any) -> None:
        if held is None:
            self.station.mover.release(self)

    # common parts

    def bind_button(self, action: Action, callback: Callback, button: ui.button, hint: str = "") -> None:
        """Bind a button to an action. While it is not permitted, the button is disabled and its tooltip says why."""
        button.on_click(self.handler(callback))
        self.live.effect(lambda s: s.situation.permits(action), button.set_enabled)
        self.live.bind(button, "title", lambda s: s.situation.refusal(action) or hint)

    def needs_robot(self, element: Control) -> Control:
        """Disable an element while the robot does not answer, which the banner at the top says. Returns the element."""
        self.live.effect(lambda s: s.connected, element.set_enabled)
        return element

    def fact(self, name: str, read: Callable[[Station], str]) -> ui.element:
        """A name and a live text, two cells of a grid. Returns the text."""
        ui.label(name)
        return self.live.text(read)

    def program_buttons(self, props: str, test_id_prefix: str) -> None:
        for icon, name, action, callback in (
            ("play_arrow", "Play", Action.PLAY, self.play),
            ("pause", "Pause", Action.PAUSE, lambda: self.station.request(dashboard.PAUSE)),
            ("stop", "Stop", Action.STOP, self.stop),
        ):
            button = ui.button(icon=icon).props(f'round unelevated {props} aria-label="{name}"')
            self.bind_button(action, callback, button.props(f"data-testid={test_id_prefix}{name.lower()}"), name)

    def show_if(self, element: ui.element, read: Callable[[Station], bool]) -> None:
        element.set_visibility(read(self.station))
        self.live.effect(read, element.set_visibility)

    def picker(
        self, accept: str, test_id: str, use: Callable[[bytes, str], object], what: str, max_mb: int = 2, done: str = ""
    ) -> Callable[[], object]:
        """A hidden field for a file of the browser's machine. Returns the function that lets the user choose one.

        use: called with the content and the name of the file. what: the kind of file, as the subject of a sentence.
        """

        async def read(upload: UploadEventArguments) -> None:
            content = await upload.file.read()
            await self.attempt(lambda: use(content, upload.file.name), done)
            field.reset()

        field = ui.upload(on_upload=read, auto_upload=True, max_file_size=max_mb * 1_000_000).classes("hidden")
        field.on("rejected", lambda: self.show_error(f"{what} has at most {max_mb} MB"))
        field.props(f'accept="{accept}" data-testid={test_id}')
        return lambda: field.run_method("pickFiles")

    @contextmanager
    def panel(self, title: str, classes: str = "") -> Iterator[ui.card]:
        with ui.card().classes(f"panel {classes}") as card:
            ui.label(title).classes("panel-title")
            yield card


def _answers(dialog: ui.dialog, yes: str, answer: Callable[[], Any], test_id: str) -> None:
    """The buttons of a dialog: Cancel, and one with the text ``yes`` unless that is empty."""
    with ui.row().classes("w-full justify-end"):
        ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat no-caps")
        if yes:
            ui.button(yes, on_click=lambda: dialog.submit(answer())).props(f"no-caps data-testid={test_id}")
