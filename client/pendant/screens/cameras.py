"""Cameras: the pictures of the cameras in an emulator's scene, and their data."""

from typing import Any, Final

from nicegui import ui

from client.pendant.cameras import camera_path
from client.pendant.page import Page
from client.pendant.station import Station

_NAME: Final = "cameras"


def build(page: Page) -> None:
    """Put it on the page."""
    with ui.element("div").classes("cameras"), page.panel("Cameras", "cameras-panel"):
        with ui.row().classes("cameras-tools"):
            choice = ui.select({}, label="Camera").props("outlined dense options-dense data-testid=camera")
            choice.classes("cameras-choice")
            pause = ui.button("Pause", icon="pause").props("unelevated no-caps data-testid=camera-pause")
        view = _View(choice, pause)
        page.live.text(lambda station: station.cameras.seen(view.name) if view.name else "", "cameras-seen").props(
            "data-testid=camera-seen"
        )
        page.live.text(_absent).props("data-testid=camera-absent")
    page.live.effect(_there, view.know)
    page.live.on_show.append(view.look)


def _there(station: Station) -> Any:
    """Not where they are: that may change all the time."""
    return tuple((camera.name, camera.width, camera.height) for camera in station.cameras.found)


def _absent(station: Station) -> str:
    return "" if station.cameras.found else "This robot has no cameras. An emulator has those of its scene (--physics)."


class _View:
    """The picture of one camera. No pictures are requested while another screen is visible."""

    def __init__(self, choice: ui.select, pause: ui.button) -> None:
        self._choice, self._pause = choice, pause
        self._looked_at = False  # it is told as soon as the screen is there
        self._paused = False
        self._cameras: dict[str, tuple[int, int]] = {}  # width and height
        self._changes = 0
        self._place = ui.element("div").classes("cameras-place")
        choice.on_value_change(lambda change: self._show())
        pause.on_click(self._switch)

    @property
    def name(self) -> str:
        """Of the camera that is shown, "" for none."""
        return str(self._choice.value) if self._choice.value in self._cameras else ""

    def know(self, cameras: Any) -> None:
        """There are others."""
        self._cameras = {name: (width, height) for name, width, height in cameras}
        before = self._choice.value
        value = before if before in self._cameras else next(iter(self._cameras), None)
        self._choice.set_options(list(self._cameras), value=value)
        if value == before:  # else that was a choice
            self._show()

    def look(self, screen: str) -> None:
        """Another screen is in view."""
        if self._looked_at is not (screen == _NAME):
            self._looked_at = screen == _NAME
            if screen:
                self._show()

    def _switch(self) -> None:
        self._paused = not self._paused
        self._pause.set_text("Go on" if self._paused else "Pause")
        self._pause.set_icon("play_arrow" if self._paused else "pause")
        self._show()

    def _show(self) -> None:
        """A new element each time: a stream that has ended is not begun again by its old address."""
        self._place.clear()
        self._choice.set_enabled(bool(self._cameras))
        self._pause.set_enabled(bool(self._cameras))
        if not self.name or not self._looked_at:
            return
        self._changes += 1
        kind, how = ("still", "stopped") if self._paused else ("stream", "live")
        with self._place:
            picture = ui.element("img").classes("cameras-picture")
        picture.props["src"] = f"{camera_path(self.name, kind)}?n={self._changes}"
        picture.props["alt"] = f"Picture of the camera {self.name}, {how}; the objects in view are listed below it"
        picture.props["width"], picture.props["height"] = self._cameras[self.name]
        picture.props["data-testid"] = "camera-picture"
