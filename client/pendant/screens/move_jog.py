"""Buttons that move the arm while they are held, next to the values that they change; freedrive; the jog speed."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from math import cos, degrees, isfinite, sin
from typing import Any, Final

from nicegui import ui

from client.errors import MotionStoppedError
from client.pendant.jogging import Velocity
from client.pendant.mover import STALE_S
from client.pendant.page import EXPECTED_ERRORS, Page
from client.pendant.readings import UNKNOWN, shown_pose
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES
from urproto.robots import Joints
from urproto.robots.pose import rotvec_to_matrix
from urproto.vectors import Matrix3

FEATURES: Final = {"base": "Base", "tool": "Tool", "view": "View"}
MAX_JOINT_SPEED: Final = 1.0472  # rad/s, of joints and of a tool's rotation; 60 degrees/s is URScript's default
MAX_LINE_SPEED: Final = 0.25  # m/s: URScript's default, and the limit of ISO 10218 in manual mode
_JOINT_ACCELERATION: Final = 1.4  # rad/s2, m/s2
_LINE_ACCELERATION: Final = 1.2
_IDENTITY: Final[Matrix3] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_AXES: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_VIEW_AXES: Final = ("Right", "Away", "Up", "Pitch", "Roll", "Yaw")  # the axes of the feature View
_NEAR_LIMIT_RAD: Final = 0.09  # rad from a limit: where a bar turns amber
_MAX_SILENCE_S: Final = 3.0  # guess: longer than a browser under load is silent, shorter than a laptop sleeps


class MoveSettings:
    """The settings of the Move screen. speed: fraction of the top speeds, 0 to 1. feature: of `FEATURES`.

    as_rpy: rotations are RPY [deg], not rotation vectors. on_rotation: called when as_rpy has changed. preview: target
    configuration [rad] that was typed or dragged, until the arm is moved in another way or the target is discarded.
    on_target: called with a target that was not typed.
    """

    def __init__(self, page: Page) -> None:
        self.page = page
        self.speed = 0.5
        self.feature = "base"
        self.as_rpy = False
        self.preview: tuple[float, ...] | None = None
        self.on_rotation: list[Callable[[bool], None]] = []
        self.on_target: list[Callable[[Joints], None]] = []
        self._moving = False
        page.live.on_lost.append(self._stop_own_motion)

    def set_rotation_format(self, *, as_rpy: bool) -> None:
        """Set how rotations are shown: as RPY or as rotation vectors."""
        if as_rpy != self.as_rpy:
            self.as_rpy = as_rpy
            for callback in self.on_rotation:
                callback(as_rpy)

    def axes(self, azimuth_rad: float) -> Matrix3:
        """Axes of the feature in the base frame. azimuth_rad: angle from the base's x axis to the right in the view."""
        pose = self.page.station.values.get("actual_TCP_pose")
        if self.feature == "tool" and pose is not None:
            return rotvec_to_matrix(*pose[3:])
        if self.feature == "view":
            s, c = sin(azimuth_rad), cos(azimuth_rad)
            return (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        return _IDENTITY

    @property
    def rotation(self) -> str:
        """The format of rotations: rv or rpy."""
        return "rpy" if self.as_rpy else "rv"

    @property
    def joint_speed(self) -> dict[str, float]:
        return {"speed_rad_s": self.speed * MAX_JOINT_SPEED, "acceleration_rad_s2": _JOINT_ACCELERATION}

    @property
    def line_speed(self) -> dict[str, float]:
        return {"speed_m_s": self.speed * MAX_LINE_SPEED, "acceleration_m_s2": _LINE_ACCELERATION}

    async def move(self, motion: Callable[[], Awaitable[None]]) -> None:
        """Start a motion to a target, if permitted; it also ends when this browser disconnects.

        Raises NotPermittedError.
        """
        self.page.station.situation.require(Action.MOVE)
        if await self.page.confirm_move():
            await self.page.attempt(lambda: self._run_motion(motion))

    async def _run_motion(self, motion: Callable[[], Awaitable[None]]) -> None:
        was_moving, self._moving = self._moving, True
        try:
            await motion()
        except MotionStoppedError:
            self.page.show_message("Stopped")
        finally:
            self._moving = was_moving  # another motion of this browser may be in progress

    def _stop_own_motion(self) -> None:
        if self._moving:
            self._stopping = asyncio.create_task(self.page.attempt(self.page.station.mover.stop))


class JogPanels:
    """The jog panels of one page. The browser keeps reporting the held button: see static/pendant.js."""

    def __init__(self, page: Page, settings: MoveSettings) -> None:
        self._page = page
        self._settings = settings
        self._pressed = False  # a button is held, and its motion has started
        self._press_failed = False  # a button is held, but its motion could not start
        self._silent = False  # freedrive has ended because its button sent no more messages
        self._confirmation: asyncio.Task[Any] | None = None
        self._freedrive_task: asyncio.Task[Any] | None = None
        self._last_message_s = 0.0
        page.live.on_held.append(self._on_held)

    # panels

    def tool(self) -> None:
        settings = self._settings
        with self._page.panel("TCP", "move-jog"):
            with ui.row().classes("move-choices"):
                _choice_toggle(FEATURES, settings, "feature")
                _choice_toggle({"rv": "Rot. vector", "rpy": "RPY"}, settings, "rotation")
            for i in range(6):
                with ui.element("div").classes("jog-row"):
                    self._page.live.text(partial(self._axis_name, i), f"jog-name axis-{'xyz'[i % 3]}")
                    self._page.live.text(partial(self._coordinate, i), "jog-value").props(f"data-testid=tcp-{i}")
                    self._page.live.text(partial(self._coordinate_unit, i), "jog-unit")
                    _hold_buttons(self._page, "axis", i, _AXES[i].lower(), _AXES[i])

    def joints(self) -> None:
        """The panel of the joints: position within the limits, angle, and buttons."""
        live = self._page.live
        with self._page.panel("Joints", "move-jog"):
            for i, title in enumerate(JOINT_TITLES):
                with ui.element("div").classes("jog-row joint-row"):
                    ui.label(title).classes("jog-name")
                    with ui.element("div").classes("joint-bar"):
                        bar = ui.element("div").classes("joint-at")
                        live.bind(bar, "width", partial(_joint_percent, i))
                        live.bind(bar, "state", partial(_limit_state, i))
                    live.text(partial(_angle_text, i), "jog-value").props(f"data-testid=angle-{i}")
                    ui.label("°").classes("jog-unit")
                    _hold_buttons(self._page, "joint", i, str(i), title)

    def speed_and_freedrive(self) -> None:
        page, settings = self._page, self._settings
        with page.panel("Speed and freedrive"):
            with ui.row().classes("move-speed"):
                ui.icon("speed")
                slider = ui.slider(min=1, max=100, value=100 * settings.speed).props(
                    'dense data-testid=jog-speed aria-label="Speed of motions from here"'
                )
                percent = ui.label(f"{100 * settings.speed:.0f} %").classes("live")

            def set_speed(change: Any) -> None:
                settings.speed = change.value / 100.0
                percent.set_text(f"{change.value:.0f} %")

            slider.on_value_change(set_speed)
            with ui.row().classes("move-hand"):
                hold_button = ui.button("Hold for freedrive", icon="pan_tool", color=None).props(
                    "no-caps unelevated data-testid=freedrive"
                )
                hold_button.props["data-hold"] = json.dumps({"freedrive": True})
                toggle_button = ui.button(
                    icon="lock_open", color=None, on_click=page.handler(self._toggle_freedrive)
                ).props("unelevated")
                page.needs_robot(hold_button)
                page.needs_robot(toggle_button)
                toggle_button.props('data-testid=freedrive-keep aria-label="Freedrive until pressed again"')
                toggle_button.tooltip("Freedrive until pressed again")
            for button in (hold_button, toggle_button):
                button.classes("hand")
                page.live.bind(button, "state", lambda station: "on" if station.mover.freedrive else "off")

    # values

    def _axis_name(self, axis: int, _: Station) -> str:
        return (_VIEW_AXES if self._settings.feature == "view" else _AXES)[axis]

    def _coordinate(self, axis: int, station: Station) -> str:
        pose = station.values.get("actual_TCP_pose")
        if pose is None:
            return UNKNOWN
        as_rpy = self._settings.as_rpy
        return _format_number(shown_pose(pose, as_rpy)[axis], 2 if axis < 3 or as_rpy else 4)

    def _coordinate_unit(self, axis: int, _: Station) -> str:
        return "mm" if axis < 3 else "°" if self._settings.as_rpy else "rad"

    # held buttons

    def _on_held(self, held: Mapping[str, Any] | None) -> None:
        mover, now = self._page.station.mover, asyncio.get_running_loop().time()
        silent_s, self._last_message_s = now - self._last_message_s, now
        if held is not None and self._pressed and not self._press_failed and silent_s > _MAX_SILENCE_S:
            self._press_failed = (
                True  # a browser that wakes from sleep still reports a button that may have been released
            )
            self._page.show_error(f"Nothing was heard of the button for {silent_s:.0f} s: press it again.")
        if held is None:
            if self._freedrive_task is not None:
                mover.end_freedrive()
            self._pressed = self._press_failed = self._silent = False
        elif not self._press_failed and self._page.live.screen == "move":
            try:
                self._press(held)
            except EXPECTED_ERRORS as error:
                self._press_failed = True
                self._page.show_error(str(error))

    def _press(self, held: Mapping[str, Any]) -> None:
        if not self._pressed:
            self._page.station.situation.require(Action.MOVE)
        self._settings.preview = None
        if not self._page.move_confirmed:
            self._press_failed = True
            self._confirmation = asyncio.create_task(self._page.confirm_move())
        elif held.get("freedrive") is True:
            # a button that was silent only for a moment is still held: as in jogging, its motion starts again
            if not self._pressed or (self._silent and self._freedrive_task is None):
                self._silent = False
                self._freedrive_task = asyncio.create_task(self._run_freedrive())
        else:
            self._page.station.mover.hold(self._velocity(held), self._page)
        self._pressed = True

    def _velocity(self, held: Mapping[str, Any]) -> Velocity:
        """The velocity for a held button. Raises ValueError if the message is invalid."""
        sign = 1.0 if held.get("sign", 0) > 0 else -1.0
        speeds = [0.0] * 6
        if "joint" in held:
            speeds[_checked_index(held["joint"])] = sign * MAX_JOINT_SPEED * self._settings.speed
            return Velocity("joints", tuple(speeds))
        axis = _checked_index(held.get("axis"))
        max_speed = sign * self._settings.speed * (MAX_LINE_SPEED if axis < 3 else MAX_JOINT_SPEED)
        azimuth = held.get("azimuth", 0.0)
        axes = self._settings.axes(float(azimuth) if isinstance(azimuth, int | float) and isfinite(azimuth) else 0.0)
        first = axis // 3 * 3
        speeds[first : first + 3] = [max_speed * value for value in axes[axis % 3 :: 3]]
        return Velocity("tool", tuple(speeds))

    async def _run_freedrive(self) -> None:
        watchdog = asyncio.create_task(self._end_freedrive_when_silent())
        try:
            await self._page.attempt(self._page.station.mover.start_freedrive)
        finally:
            watchdog.cancel()
            self._freedrive_task = None

    async def _end_freedrive_when_silent(self) -> None:
        now = asyncio.get_running_loop().time
        while now() - self._last_message_s < STALE_S:
            await asyncio.sleep(STALE_S / 8)
        self._silent = True
        self._page.station.mover.end_freedrive()

    async def _toggle_freedrive(self) -> None:
        mover = self._page.station.mover
        if mover.freedrive:
            mover.end_freedrive()
        else:
            await self._settings.move(mover.start_freedrive)


def _choice_toggle(options: Mapping[str, str], settings: MoveSettings, setting: str) -> None:
    def choose(change: Any) -> None:
        if setting == "feature":
            settings.feature = change.value
        else:
            settings.set_rotation_format(as_rpy=change.value == "rpy")

    toggle = ui.toggle(dict(options), value=next(iter(options)), on_change=choose)
    toggle.props(f"no-caps dense unelevated data-testid={setting}").classes("move-choice")
    settings.page.live.bind(toggle, "state", lambda _: settings.feature if setting == "feature" else settings.rotation)


def _hold_buttons(page: Page, kind: str, index: int, test_id: str, title: str) -> None:
    for sign, icon, name in ((-1, "remove", "minus"), (1, "add", "plus")):
        button = (
            ui.button(icon=icon, color=None)
            .props(f'unelevated dense data-testid={kind}-{test_id}-{name} aria-label="{title} {name}, while held"')
            .classes("jog-button")
        )
        button.props["data-hold"] = json.dumps({kind: index, "sign": sign})
        page.needs_robot(button)


def _checked_index(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 6:
        raise ValueError(f"there is no axis {value!r}")
    return value


def _format_number(value: float, digits: int) -> str:
    """Format a number with a minus sign as wide as the digits, and without one before zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text.replace("-", "\N{MINUS SIGN}")


def _angle_text(joint: int, station: Station) -> str:
    q = station.values.get("actual_q")
    return UNKNOWN if q is None else _format_number(degrees(q[joint]), 2)


def _limits(joint: int, station: Station) -> tuple[float, float]:
    model = station.model
    return (-1.0, 1.0) if model is None else (model.q_min[joint], model.q_max[joint])


def _joint_percent(joint: int, station: Station) -> float:
    """Position of a joint between its limits [percent]."""
    q: Joints | None = station.values.get("actual_q")
    if q is None:
        return 50.0
    low, high = _limits(joint, station)
    return round(100.0 * max(0.0, min(1.0, (q[joint] - low) / (high - low))), 1)


def _limit_state(joint: int, station: Station) -> str:
    q, model = station.values.get("actual_q"), station.model
    if q is None or model is None:
        return "unknown"
    low, high = model.position_limits
    return "near" if q[joint] - low[joint] < _NEAR_LIMIT_RAD or high[joint] - q[joint] < _NEAR_LIMIT_RAD else "far"
