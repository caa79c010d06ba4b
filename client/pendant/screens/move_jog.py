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
from client.pendant.page import MISTAKES, Page
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES
from urproto.robots import Joints
from urproto.robots.pose import rotvec_to_matrix, rotvec_to_rpy
from urproto.vectors import Matrix3

FEATURES: Final = {"base": "Base", "tool": "Tool", "view": "View"}
JOINT_TOP: Final = 1.0472  # rad/s, and rad/s of a tool: speeds at 100 %; 60 degrees a second is URScript's default
LINE_TOP: Final = 0.25  # m/s: URScript's default, and what ISO 10218 lets an arm move at in manual mode
_JOINT_RAMP: Final = 1.4  # rad/s2, m/s2
_LINE_RAMP: Final = 1.2
_IDENTITY: Final[Matrix3] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


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
        self._mine = False
        page.live.on_lost.append(self._stop_what_i_began)

    def write_rotations(self, *, as_rpy: bool) -> None:
        """So from now on."""
        if as_rpy != self.as_rpy:
            self.as_rpy = as_rpy
            for tell in self.on_rotation:
                tell(as_rpy)

    def axes(self, azimuth_rad: float) -> Matrix3:
        """Of the feature, in the base frame. azimuth: how far what the camera calls right is from the base's x."""
        pose = self.page.station.values.get("actual_TCP_pose")
        if self.feature == "tool" and pose is not None:
            return rotvec_to_matrix(*pose[3:])
        if self.feature == "view":
            s, c = sin(azimuth_rad), cos(azimuth_rad)
            return (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        return _IDENTITY

    @property
    def rotation(self) -> str:
        """How rotations are written: rv or rpy."""
        return "rpy" if self.as_rpy else "rv"

    @property
    def joint_speed(self) -> dict[str, float]:
        """For move_j."""
        return {"speed_rad_s": self.speed * JOINT_TOP, "acceleration_rad_s2": _JOINT_RAMP}

    @property
    def line_speed(self) -> dict[str, float]:
        """For move_l."""
        return {"speed_m_s": self.speed * LINE_TOP, "acceleration_m_s2": _LINE_RAMP}

    async def move(self, motion: Callable[[], Awaitable[None]]) -> None:
        """Begin a motion that ends by itself, if it may be; it ends too when this browser is gone.

        Raises NotNowError.
        """
        self.page.station.situation.require(Action.MOVE)
        if await self.page.may_move():
            await self.page.attempt(lambda: self._moved(motion))

    async def _moved(self, motion: Callable[[], Awaitable[None]]) -> None:
        mine, self._mine = self._mine, True
        try:
            await motion()
        except MotionStoppedError:
            self.page.tell("Stopped")
        finally:
            self._mine = mine  # another motion of this browser may be the one that is under way

    def _stop_what_i_began(self) -> None:
        if self._mine:
            self._stopping = asyncio.create_task(self.page.attempt(self.page.station.mover.stop))


_AXES: Final = ("X", "Y", "Z", "RX", "RY", "RZ")
_SEEN: Final = ("Right", "Away", "Up", "Pitch", "Roll", "Yaw")  # the same in feature View
_NEAR: Final = 0.09  # rad from a limit: where a bar turns amber
_ASLEEP_S: Final = 3.0  # guess: longer than a busy browser is silent, shorter than a laptop sleeps or a network is gone
_NOTHING: Final = "\N{EN DASH}"


class JogPanels:
    """The jog panels of one page. The browser keeps reporting the held button: see static/pendant.js."""

    def __init__(self, page: Page, settings: MoveSettings) -> None:
        self._page = page
        self._settings = settings
        self._down = False  # a button is, and what it was pressed for has begun
        self._dead = False  # it is, but this press has failed
        self._silent = False  # freedrive has ended because nothing was heard of its button
        self._asking: asyncio.Task[Any] | None = None
        self._freeing: asyncio.Task[Any] | None = None
        self._heard_at = 0.0
        page.live.on_held.append(self._held)

    # the panels

    def tool(self) -> None:
        """Of the TCP."""
        settings = self._settings
        with self._page.panel("TCP", "move-jog"):
            with ui.row().classes("move-choices"):
                _choice(FEATURES, settings, "feature")
                _choice({"rv": "Rot. vector", "rpy": "RPY"}, settings, "rotation")
            for i in range(6):
                with ui.element("div").classes("jog-row"):
                    self._page.live.text(partial(self._axis_name, i), f"jog-name axis-{'xyz'[i % 3]}")
                    self._page.live.text(partial(self._coordinate, i), "jog-value").props(f"data-testid=tcp-{i}")
                    self._page.live.text(partial(self._coordinate_unit, i), "jog-unit")
                    _hold_buttons("axis", i, _AXES[i].lower(), _AXES[i])

    def joints(self) -> None:
        """One row each: where it is within its limits, its angle, its buttons."""
        live = self._page.live
        with self._page.panel("Joints", "move-jog"):
            for i, title in enumerate(JOINT_TITLES):
                with ui.element("div").classes("jog-row joint-row"):
                    ui.label(title).classes("jog-name")
                    with ui.element("div").classes("joint-bar"):
                        bar = ui.element("div").classes("joint-at")
                        live.bind(bar, "width", partial(_share, i))
                        live.bind(bar, "state", partial(_nearness, i))
                    live.text(partial(_angle, i), "jog-value").props(f"data-testid=angle-{i}")
                    ui.label("°").classes("jog-unit")
                    _hold_buttons("joint", i, str(i), title)

    def by_hand(self) -> None:
        """How fast everything here goes; freedrive."""
        page, settings = self._page, self._settings
        with page.panel("Speed and freedrive"):
            with ui.row().classes("move-speed"):
                ui.icon("speed")
                slider = ui.slider(min=1, max=100, value=100 * settings.speed).props(
                    'dense data-testid=jog-speed aria-label="Speed of motions from here"'
                )
                share = ui.label(f"{100 * settings.speed:.0f} %").classes("live")

            def set_speed(change: Any) -> None:
                settings.speed = change.value / 100.0
                share.set_text(f"{change.value:.0f} %")

            slider.on_value_change(set_speed)
            with ui.row().classes("move-hand"):
                hold = ui.button("Hold for freedrive", icon="pan_tool", color=None).props(
                    "no-caps unelevated data-testid=freedrive"
                )
                hold.props["data-hold"] = json.dumps({"freedrive": True})
                keep = ui.button(icon="lock_open", color=None, on_click=page.doing(self._toggle_freedrive)).props(
                    "unelevated"
                )
                keep.props('data-testid=freedrive-keep aria-label="Freedrive until pressed again"')
                keep.tooltip("Freedrive until pressed again")
            for button in (hold, keep):
                button.classes("hand")
                page.live.bind(button, "state", lambda station: "on" if station.mover.freedrive else "off")

    # the numbers

    def _axis_name(self, axis: int, _: Station) -> str:
        return (_SEEN if self._settings.feature == "view" else _AXES)[axis]

    def _coordinate(self, axis: int, station: Station) -> str:
        pose = station.values.get("actual_TCP_pose")
        if pose is None:
            return _NOTHING
        if axis < 3:
            return _rounded(1e3 * pose[axis], 2)
        if self._settings.as_rpy:
            return _rounded(degrees(rotvec_to_rpy(*pose[3:])[axis - 3]), 2)
        return _rounded(pose[axis], 4)

    def _coordinate_unit(self, axis: int, _: Station) -> str:
        return "mm" if axis < 3 else "°" if self._settings.as_rpy else "rad"

    # what is held

    def _held(self, held: Mapping[str, Any] | None) -> None:
        mover, now = self._page.station.mover, asyncio.get_running_loop().time()
        silent_s, self._heard_at = now - self._heard_at, now
        if held is not None and self._down and not self._dead and silent_s > _ASLEEP_S:
            self._dead = True  # a browser that wakes up still holds what nobody may hold any more
            self._page.complain(f"Nothing was heard of the button for {silent_s:.0f} s: press it again.")
        if held is None:
            if self._freeing is not None:
                mover.end_freedrive()
            self._down = self._dead = self._silent = False
        elif not self._dead and self._page.live.screen == "move":
            try:
                self._press(held)
            except MISTAKES as error:
                self._dead = True
                self._page.complain(str(error))

    def _press(self, held: Mapping[str, Any]) -> None:
        if not self._down:
            self._page.station.situation.require(Action.MOVE)
        self._settings.preview = None
        if not self._page.agreed:
            self._dead = True
            self._asking = asyncio.create_task(self._page.may_move())
        elif held.get("freedrive") is True:
            # a button that was silent for a moment only is still held: as with a jog, its motion begins again
            if not self._down or (self._silent and self._freeing is None):
                self._silent = False
                self._freeing = asyncio.create_task(self._free())
        else:
            self._page.station.mover.hold(self._velocity(held), self._page)
        self._down = True

    def _velocity(self, held: Mapping[str, Any]) -> Velocity:
        """What a button means. Raises ValueError for what none says."""
        sign = 1.0 if held.get("sign", 0) > 0 else -1.0
        speeds = [0.0] * 6
        if "joint" in held:
            speeds[_index(held["joint"])] = sign * JOINT_TOP * self._settings.speed
            return Velocity("joints", tuple(speeds))
        axis = _index(held.get("axis"))
        top = sign * self._settings.speed * (LINE_TOP if axis < 3 else JOINT_TOP)
        azimuth = held.get("azimuth", 0.0)
        axes = self._settings.axes(float(azimuth) if isinstance(azimuth, int | float) and isfinite(azimuth) else 0.0)
        part = axis // 3 * 3
        speeds[part : part + 3] = [top * value for value in axes[axis % 3 :: 3]]
        return Velocity("tool", tuple(speeds))

    async def _free(self) -> None:
        watching = asyncio.create_task(self._end_when_silent())
        try:
            await self._page.attempt(self._page.station.mover.start_freedrive)
        finally:
            watching.cancel()
            self._freeing = None

    async def _end_when_silent(self) -> None:
        now = asyncio.get_running_loop().time
        while now() - self._heard_at < STALE_S:
            await asyncio.sleep(STALE_S / 8)
        self._silent = True
        self._page.station.mover.end_freedrive()

    async def _toggle_freedrive(self) -> None:
        mover = self._page.station.mover
        if mover.freedrive:
            mover.end_freedrive()
        else:
            await self._settings.move(mover.start_freedrive)


def _choice(options: Mapping[str, str], settings: MoveSettings, what: str) -> None:
    def choose(change: Any) -> None:
        if what == "feature":
            settings.feature = change.value
        else:
            settings.write_rotations(as_rpy=change.value == "rpy")

    toggle = ui.toggle(dict(options), value=next(iter(options)), on_change=choose)
    toggle.props(f"no-caps dense unelevated data-testid={what}").classes("move-choice")
    settings.page.live.bind(toggle, "state", lambda _: settings.feature if what == "feature" else settings.rotation)


def _hold_buttons(kind: str, index: int, mark: str, title: str) -> None:
    for sign, icon, name in ((-1, "remove", "minus"), (1, "add", "plus")):
        button = (
            ui.button(icon=icon, color=None)
            .props(f'unelevated dense data-testid={kind}-{mark}-{name} aria-label="{title} {name}, while held"')
            .classes("jog-button")
        )
        button.props["data-hold"] = json.dumps({kind: index, "sign": sign})


def _index(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 6:
        raise ValueError(f"there is no axis {value!r}")
    return value


def _rounded(value: float, digits: int) -> str:
    """With a minus as wide as the digits, and none before a zero."""
    text = f"{value:.{digits}f}"
    return text.removeprefix("-") if not text.strip("-0.") else text.replace("-", "\N{MINUS SIGN}")


def _angle(joint: int, station: Station) -> str:
    q = station.values.get("actual_q")
    return _NOTHING if q is None else _rounded(degrees(q[joint]), 2)


def _limits(joint: int, station: Station) -> tuple[float, float]:
    model = station.model
    return (-1.0, 1.0) if model is None else (model.q_min[joint], model.q_max[joint])


def _share(joint: int, station: Station) -> float:
    """Where a joint is between its limits [percent]; one without limits turns round and round."""
    q: Joints | None = station.values.get("actual_q")
    if q is None:
        return 50.0
    low, high = _limits(joint, station)
    return round(100.0 * max(0.0, min(1.0, (q[joint] - low) / (high - low))), 1)


def _nearness(joint: int, station: Station) -> str:
    q, model = station.values.get("actual_q"), station.model
    if q is None or model is None:
        return "unknown"
    low, high = model.position_limits
    return "near" if q[joint] - low[joint] < _NEAR or high[joint] - q[joint] < _NEAR else "far"
