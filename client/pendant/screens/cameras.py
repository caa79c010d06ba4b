"""Cameras: the pictures of the cameras in an emulator's scene, and their data."""

from typing import Any, Final

from nicegui import ui

from client.pendant.cameras import camera_path
from client.pendant.page import Page
from client.pendant.station import Station

_NAME: Final = "cameras"
_NO_CAMERAS: Final = "This robot has no cameras. An emulator has those of its scene (--physics)."


def build(page: Page) -> None:
    with ui.element("div").classes("cameras"), page.panel("Cameras", "cameras-panel"):
        with ui.row().classes("cameras-tools"):
            choice = ui.select({}, label="Camera").props("outlined dense options-dense data-testid=camera")
            choice.classes("cameras-choice")
            pause = ui.button("Pause", icon="pause").props("unelevated no-caps data-testid=camera-pause")
        view = _View(choice, pause)
        page.live.text(
            lambda station: station.cameras.view_description(view.name) if view.name else "", "cameras-description"
        ).props("data-testid=camera-view")
        page.live.text(lambda s: "" if s.cameras.available else _NO_CAMERAS).props("data-testid=camera-absent")
    page.live.effect(_available_cameras, view.set_cameras)
    page.live.on_show.append(view.on_screen_change)


def _available_cameras(station: Station) -> Any:
    """Names and sizes of the cameras, without their poses, which may change constantly."""
    return tuple((camera.name, camera.width, camera.height) for camera in station.cameras.available)


class _View:
    """The picture of one camera. No pictures are requested while another screen is visible."""

    def __init__(self, choice: ui.select, pause: ui.button) -> None:
        self._choice, self._pause = choice, pause
        self._visible = False  # updated as soon as the screen is shown
        self._paused = False
        self._cameras: dict[str, tuple[int, int]] = {}  # width and height
        self._change_count = 0
        self._frame = ui.element("div").classes("cameras-place")
        choice.on_value_change(lambda change: self._show())
        pause.on_click(self._toggle_pause)

    @property
    def name(self) -> str:
        """The name of the shown camera, "" for none."""
        return str(self._choice.value) if self._choice.value in self._cameras else ""

    def set_cameras(self, cameras: Any) -> None:
        self._cameras = {name: (width, height) for name, width, height in cameras}
        previous = self._choice.value
        value = previous if previous in self._cameras else next(iter(self._cameras), None)
        self._choice.set_options(list(self._cameras), value=value)
        if value == previous:  # else the change of the selection shows it
            self._show()

    def on_screen_change(self, screen: str) -> None:
        if self._visible is not (screen == _NAME):
            self._visible = screen == _NAME
            if screen:
                self._show()

    def _toggle_pause(self) -> None:
        self._paused = not self._paused
        self._pause.set_text("Resume" if self._paused else "Pause")
        self._pause.set_icon("play_arrow" if self._paused else "pause")
        self._show()

    def _show(self) -> None:
        """Show the picture in a new element, because an ended stream does not restart at its old address."""
        self._frame.clear()
        self._choice.set_enabled(bool(self._cameras))
        self._pause.set_enabled(bool(self._cameras))
        if not self.name or not self._visible:
            return
        self._change_count += 1
        kind, state = ("still", "stopped") if self._paused else ("stream", "live")
        with self._frame:
            picture = ui.element("img").classes("cameras-picture")
        picture.props["src"] = f"{camera_path(self.name, kind)}?n={self._change_count}"
        picture.props["alt"] = f"Picture of the camera {self.name}, {state}; the objects in view are listed below it"
        picture.props["width"], picture.props["height"] = self._cameras[self.name]
        picture.props["data-testid"] = "camera-picture"
