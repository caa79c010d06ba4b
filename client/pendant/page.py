"""The page of one browser: the frame around the screens, and functions that all screens share."""

from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Final

from nicegui import background_tasks, ui
from nicegui.elements.mixins.value_element import ValueElement

from client import dashboard
from client.errors import ClientError
from client.pendant.live import Live
from client.pendant.situation import Action, NotNowError
from client.pendant.station import Station
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.errors import URError
from urproto.modes import RuntimeState
from urproto.text import readable

_SOON_S: Final = 1.5  # guess: states and answers come within a tenth of that


class NotTakenError(ClientError):
    """The robot accepted a command without an error, but did not carry it out."""


def choice(
    page: "Page",
    element: ValueElement[Any],
    read: Callable[[Station], Any],
    choose: Callable[[Any], Awaitable[Any]],
    what: str,
) -> None:
    """Let an element follow the robot, and the robot what is chosen with it; ``what`` is what to call it."""
    station = page.station

    async def chosen() -> None:
        wanted = element.value
        if not await page.attempt(
            lambda: take(station, lambda: choose(wanted), lambda s: read(s) == wanted, f"{what} {wanted}")
        ):
            element.set_value(read(station))

    element.on("update:model-value", chosen)
    page.live.effect(read, element.set_value)


async def take(
    station: Station, tell: Callable[[], Awaitable[Any]], taken: Callable[[Station], bool], what: str
) -> None:
    """Tell the robot something and wait until it has it. Raises NotTakenError, and what ``tell`` raises."""
    heard = station.log.count
    await tell()
    if not await happens(station, taken):
        said = [event.text for event in station.log.since(heard) if event.severity == "error"]
        reason = f"it says: {'; '.join(said)}" if said else "is it in local control, or without power?"
        raise NotTakenError(f"the robot did not accept {what}: {reason}")


async def happens(station: Station, condition: Callable[[Station], bool]) -> bool:
    """Whether it holds soon."""
    try:
        async with timeout(_SOON_S):
            while not condition(station):
                await station.next_frame()
    except TimeoutError:
        return False
    return True


class Views:
    """Tabs with their panels; ``name`` is that of the screen.

    on_look: called with the view that becomes visible, "" if none of them is.
    """

    def __init__(self, page: "Page", name: str, titles: Mapping[str, str]) -> None:
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


MISTAKES: Final = (URError, OSError, ValueError)
"""What goes wrong with robots and inputs; its text is for people."""

Deed = Callable[[], Awaitable[Any]]


class Page:
    """The page of one browser, passed to every screen that builds a part of it.

    station: the robot, shared by all pages. live: the live values. confirmed: the user has agreed that this page may
    move a real arm. on_close: called when the browser has disconnected.
    """

    def __init__(self, station: Station, live: Live) -> None:
        self.station = station
        self.live = live
        self.confirmed = False
        self.on_close: list[Callable[[], None]] = []
        self._content = ui.context.client.content
        station.mover.on_error.append(self.complain)
        live.on_held.append(self._stop_when_let_go)

    @property
    def content(self) -> ui.element:
        """Where dialogues are made: not among the elements of a screen."""
        return self._content

    def close(self) -> None:
        """The browser is gone."""
        self.station.mover.on_error.remove(self.complain)
        self.live.close()
        for end in self.on_close:
            end()

    # telling

    def complain(self, text: str) -> None:
        """Show what went wrong until somebody has read it."""
        with self._content:
            ui.notify(text, type="negative", multi_line=True, close_button="OK", timeout=10_000, position="top")

    def tell(self, text: str) -> None:
        """Show for a moment what has been done."""
        with self._content:
            ui.notify(text, type="positive", timeout=2_000, position="top")

    # doing

    async def attempt(self, action: Deed, done: str = "") -> bool:
        """Do it and say what went wrong, or what has been done. True if all went well."""
        try:
            await action()
        except MISTAKES as error:
            self.complain(readable(str(error)))
            return False
        if done:
            self.tell(done)
        return True

    def doing(self, action: Deed, done: str = "") -> Callable[[], Awaitable[None]]:
        """For a button: ``ui.button("Off", on_click=page.doing(lambda: page.ask(dashboard.POWER_OFF)))``."""

        async def click() -> None:
            await self.attempt(action, done)

        return click

    def soon(self, action: Deed) -> None:
        """Begin to do it, from where nothing can be waited for; what goes wrong is said."""
        background_tasks.create(self.attempt(action))

    async def play(self) -> None:
        """Start or resume the program; a control program of ours gives way."""
        station = self.station
        station.situation.require(Action.PLAY)
        if not await self.may_move():
            return
        if station.mover.in_charge:
            await station.mover.give_back()
        await station.ask(dashboard.PLAY)

    async def stop(self) -> None:
        """End the program, whoever's it is, and so what moves the arm."""
        mover = self.station.mover
        if mover.in_charge:
            await mover.stop()
        await self.station.ask(dashboard.STOP)

    async def switch_simulation(self) -> None:
        """Turn the switch between Simulation and Real Robot to the other side."""
        station, on = self.station, not self.station.simulating
        if station.mover.in_charge:
            await station.mover.give_back()
            await happens(station, lambda s: s.runtime_state is RuntimeState.STOPPED)
        if station.runtime_state is not RuntimeState.STOPPED:
            raise NotNowError("A program runs: stop it before you switch between simulation and the real robot.")
        what = "simulation" if on else "the real robot"
        await take(station, lambda: station.simulate(on), lambda s: s.simulating is on, f"the switch to {what}")

    @property
    def agreed(self) -> bool:
        """The arm may be moved from here without asking."""
        return self.station.emulator.available or self.station.simulating or self.confirmed

    async def may_move(self) -> bool:
        """Whether the arm may be moved from here: on a robot a person has to agree, once a page."""
        if self.agreed:
            return True
        text = f"The arm at {self.station.robot_ip} is going to move. Is its workspace clear?"
        self.confirmed = await self.confirm("This is a real robot", text, "It may move", "may-move")
        return self.confirmed

    async def confirm(self, title: str, text: str, yes: str, mark: str = "agree") -> bool:
        """Ask whoever is at this browser. mark: the test id of the button that agrees."""
        with self._content, ui.dialog() as dialog, ui.card():
            ui.label(title).classes("text-h6")
            ui.label(text)
            with ui.row().classes("w-full justify-end"):
                ui.button("Cancel", on_click=lambda: dialog.submit(False)).props("flat")
                ui.button(yes, on_click=lambda: dialog.submit(True)).props(f"data-testid={mark}")
            dialog.on("hide", dialog.delete)  # deleted before, its veil may stay
        return bool(await dialog)

    def _stop_when_let_go(self, held: Any) -> None:
        if held is None:
            self.station.mover.release(self)

    # parts that look alike everywhere

    def button_for(self, action: Action, deed: Deed, button: ui.button, hint: str = "") -> None:
        """Let a button do what the arm may do now; where it may not, the button is off and its hint says why."""
        button.on_click(self.doing(deed))
        self.live.effect(lambda s: s.situation.may(action), button.set_enabled)
        self.live.bind(button, "title", lambda s: s.situation.why_not(action) or hint)

    def program_buttons(self, look: str, mark: str) -> None:
        """Play, pause and stop of the program. mark: what their test ids begin with."""
        for icon, name, action, deed in (
            ("play_arrow", "Play", Action.PLAY, self.play),
            ("pause", "Pause", Action.PAUSE, lambda: self.station.ask(dashboard.PAUSE)),
            ("stop", "Stop", Action.STOP, self.stop),
        ):
            button = ui.button(icon=icon).props(f'round unelevated {look} aria-label="{name}"')
            self.button_for(action, deed, button.props(f"data-testid={mark}{name.lower()}"), name)

    def show_if(self, element: ui.element, read: Callable[[Station], bool]) -> None:
        """Show an element only while it is true; from the beginning."""
        element.set_visibility(read(self.station))
        self.live.effect(read, element.set_visibility)

    @contextmanager
    def panel(self, title: str, classes: str = "") -> Iterator[ui.card]:
        """A box with a title."""
        with ui.card().classes(f"panel {classes}") as card:
            ui.label(title).classes("panel-title")
            yield card
