"""Typed targets: joint angles in degrees, or a pose of the TCP in mm with its rotation."""

from math import degrees, inf, isfinite, radians
from typing import Final

from nicegui import ui

from client.errors import FileError
from client.pendant.page import Callback, Page
from client.pendant.readings import entered_pose, rotation_names, shown_pose
from client.pendant.saved import BUILT_IN
from client.pendant.screens.move_jog import MoveSettings
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.joints import JOINT_TITLES
from urproto.robots import Joints, RobotModel
from urproto.robots.pose import Pose

_ICONS: Final = {"Home": "home", "Zero": "exposure_zero"}
_MAX_RANGE_DEG: Final = 360.0  # of a slider for a joint without limits
_POSITIONS: Final = ("X", "Y", "Z")


def saved_poses(page: Page, settings: MoveSettings) -> None:
    """The list of poses that all browsers share, and a form to add one."""
    pose_list = ui.element("div").classes("pose-list")

    def show(version: tuple[str, int] | None) -> None:
        pose_list.clear()
        if version is not None:
            with pose_list:
                for name, q_rad in BUILT_IN.items():
                    _pose_row(page, settings, name, q_rad, is_user_pose=False)
                for name, q_rad in _read_poses(page, version[0]).items():
                    _pose_row(page, settings, name, q_rad, is_user_pose=True)

    page.live.effect(_list_version, show)
    with ui.row().classes("target-buttons"):
        box = ui.input(placeholder="Name of the present pose").props(
            'dense outlined data-testid=pose-name aria-label="Name of the present pose"'
        )
        box.classes("pose-name")

        def save() -> None:
            station = page.station
            q = station.values.get("actual_q")
            if q is None:
                raise RobotRefused(
                    "saving a pose", "the robot has not reported where it is", "wait until it is connected"
                )
            station.poses.save(_model_name(station), box.value or "", q)
            box.set_value("")

        save_button = page.needs_robot(ui.button("Save", icon="add", on_click=page.handler(save)))
        save_button.props("unelevated no-caps data-testid=pose-save")
        box.on("keydown.enter", page.handler(save))


def _list_version(station: Station) -> tuple[str, int] | None:
    """Model and version of the list of poses."""
    return None if station.model is None else (station.model.name, station.poses.version)


def _model_name(station: Station) -> str:
    if station.model is None:
        raise RobotRefused("saved poses", "it has not reported which arm it is", "wait until it is connected")
    return station.model.name


def _read_poses(page: Page, model: str) -> dict[str, Joints]:
    try:
        return page.station.poses.for_model(model)
    except FileError as error:
        page.show_error(str(error))
        return {}


def _pose_row(page: Page, settings: MoveSettings, name: str, q_rad: Joints, *, is_user_pose: bool) -> None:
    async def move() -> None:
        await settings.move(lambda: page.station.mover.move_j(q_rad, f"Moving to {name}", **settings.joint_speed))

    with ui.element("div").classes("pose-row"):
        ui.icon("place" if is_user_pose else _ICONS.get(name, "place"))
        ui.label(name).classes("pose-title")
        if is_user_pose:
            _pose_menu(page, name)
        button = page.needs_robot(ui.button("Go", icon="near_me", on_click=page.handler(move))).props(
            "flat no-caps dense"
        )
        button.props["data-testid"] = f"go-{name}"


def _pose_menu(page: Page, name: str) -> None:
    station = page.station
    with ui.button(icon="more_vert").props('flat dense round aria-label="Rename or delete"') as button, ui.menu():
        ui.menu_item("Rename…", lambda: _rename(page, name)).props("data-testid=pose-rename")
        delete = page.handler(lambda: station.poses.delete(_model_name(station), name))
        ui.menu_item("Delete", delete).props("data-testid=pose-delete")
    button.props["data-testid"] = f"menu-{name}"


async def _rename(page: Page, name: str) -> None:
    station, title = page.station, "Rename pose"

    def field() -> ui.input:
        return ui.input(value=name).props(f'autofocus outlined dense data-testid=pose-new-name aria-label="{title}"')

    new_name = await page.request_value(title, field, "Rename", "pose-renamed")
    if new_name is not None:
        await page.attempt(lambda: station.poses.rename(_model_name(station), name, new_name))


def joint_target(page: Page, settings: MoveSettings) -> None:
    """Sliders and fields for six joint angles, and a button that moves the arm there."""
    numbers = []
    sliders = []
    with ui.element("div").classes("target-grid"):
        for i, title in enumerate(JOINT_TITLES):
            ui.label(title).classes("jog-name")
            slider = ui.slider(min=-_MAX_RANGE_DEG, max=_MAX_RANGE_DEG, step=0.1, value=0.0).props("dense")
            slider.props(f'aria-label="{title}"')
            number = ui.number(value=0.0, format="%.2f", step=1).props(f"dense outlined data-testid=target-joint-{i}")
            number.props(f'aria-label="{title} [°]"')
            number.bind_value(slider)
            ui.label("°").classes("jog-unit")
            numbers.append(number)
            sliders.append(slider)

    def preview() -> None:
        if all(number.value is not None for number in numbers):
            settings.preview = tuple(radians(number.value) for number in numbers)

    def show(q_rad: Joints) -> None:
        for number, angle in zip(numbers, q_rad, strict=True):
            number.set_value(round(degrees(angle), 2))

    def show_current() -> None:
        show(_current_values(page, "actual_q"))
        settings.preview = None

    def set_limits(model: RobotModel | None) -> None:
        if model is not None:
            for slider, low, high in zip(sliders, *model.position_limits, strict=True):
                slider.props(
                    f"min={max(degrees(low), -_MAX_RANGE_DEG):.1f} max={min(degrees(high), _MAX_RANGE_DEG):.1f}"
                )
            show_current()

    async def move() -> None:
        q = _require_within_limits(page.station.model, [radians(_number(number)) for number in numbers])
        await settings.move(lambda: page.station.mover.move_j(q, "Moving to joint angles", **settings.joint_speed))
        settings.preview = None

    for number in numbers:
        number.on_value_change(preview)
    settings.on_target.append(show)
    page.live.effect(lambda station: station.model if "actual_q" in station.values else None, set_limits)
    with ui.row().classes("target-buttons"):
        _present_button(page, show_current, "joints-present")
        ui.space()
        _move_button(page, move, "joints-move")


def pose_target(page: Page, settings: MoveSettings) -> None:
    """Fields for a pose, and a button that moves the TCP there: in joint space, or in a straight line."""
    fields = {}
    with ui.element("div").classes("target-grid pose-grid"):
        for i in (0, 3, 1, 4, 2, 5):
            fields[i] = _pose_field(page, settings, i)
    numbers = [fields[i] for i in range(6)]

    def show(pose: Pose) -> None:
        for number, value in zip(numbers, shown_pose(pose, settings.as_rpy), strict=True):
            number.set_value(round(value, 4))

    def read(as_rpy: bool) -> Pose:
        return entered_pose(list(map(_number, numbers)), as_rpy)

    async def move() -> None:
        pose, mover = read(settings.as_rpy), page.station.mover
        activity = "Moving to a pose"
        if kind.value == "l":
            await settings.move(lambda: mover.move_l(pose, activity, **settings.line_speed))
        else:
            await settings.move(lambda: mover.move_to_pose(pose, activity, **settings.joint_speed))

    def convert_rotation(as_rpy: bool) -> None:
        if all(number.value is not None for number in numbers):
            show(read(not as_rpy))

    settings.on_rotation.append(convert_rotation)

    def show_initial(available: bool) -> None:
        if available:
            show(_tcp_pose(page))

    page.live.effect(lambda station: "actual_TCP_pose" in station.values, show_initial)
    with ui.row().classes("target-buttons"):
        _present_button(page, lambda: show(_tcp_pose(page)), "pose-present")
        ui.space()
        kind = ui.toggle({"j": "MoveJ", "l": "MoveL"}, value="j").props(
            "no-caps dense unelevated data-testid=pose-kind"
        )
        kind.classes("move-choice")
        _move_button(page, move, "pose-move")


def _pose_field(page: Page, settings: MoveSettings, i: int) -> ui.number:
    name = (*_POSITIONS, "RX or roll", "RY or pitch", "RZ or yaw")[i]
    if i < 3:
        ui.label(_POSITIONS[i]).classes(f"jog-name axis-{'xyz'[i]}")
        number = ui.number(value=0.0, format="%.2f", step=1)
        ui.label("mm").classes("jog-unit")
    else:
        page.live.text(lambda _: rotation_names(settings.as_rpy)[i - 3], f"jog-name axis-{'xyz'[i - 3]}")
        number = ui.number(value=0.0, format="%.4f", step=0.01)
        page.live.text(lambda _: "°" if settings.as_rpy else "rad", "jog-unit")
    return number.props(f'dense outlined data-testid=target-pose-{i} aria-label="{name}"')


def _current_values(page: Page, name: str) -> Joints:
    values: Joints | None = page.station.values.get(name)
    if values is None:
        raise RobotRefused(name, "the robot has not reported it yet", "wait until it is connected")
    return values


def _tcp_pose(page: Page) -> Pose:
    return _current_values(page, "actual_TCP_pose")


def _number(field: ui.number) -> float:
    if field.value is None or not isfinite(field.value):
        raise ValueError("a number is missing: fill in all six")
    return float(field.value)


def _require_within_limits(model: RobotModel | None, q_rad: list[float]) -> list[float]:
    """Raises ValueError with the limits, in degrees as on the screen."""
    lows, highs = ((-inf,) * 6, (inf,) * 6) if model is None else model.position_limits
    for title, low, angle, high in zip(JOINT_TITLES, lows, q_rad, highs, strict=True):
        if not low <= angle <= high:
            limits = f"{degrees(low):.1f}° and {degrees(high):.1f}°"
            raise ValueError(f"{title} cannot go to {degrees(angle):.2f}°: its limits are {limits}")
    return q_rad


def _present_button(page: Page, action: Callback, test_id: str) -> None:
    button = ui.button("Present", icon="my_location", on_click=page.handler(action))
    button.props(f"flat no-caps data-testid={test_id}")


def _move_button(page: Page, action: Callback, test_id: str) -> None:
    button = ui.button("Move", icon="near_me").props(f"unelevated no-caps data-testid={test_id}")
    page.bind_button(Action.MOVE, action, button)
