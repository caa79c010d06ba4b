"""Data of the robot: model, software, calibration, limits, safety."""

import asyncio
import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from nicegui import ui

from client import dashboard
from client.calibration import calibration_of, is_nominal, write_calibration
from client.dashboard_commands import Operation
from client.pendant.page import Page, Views
from client.pendant.readings import board_text
from client.pendant.station import Station
from urproto.errors import RobotRefused
from urproto.joints import JOINT_TITLES
from urproto.modes import ControllerBox, mode_name
from urproto.primary.subpackages import ConfigurationData, KinematicsInfo
from urproto.robots import Calibration, CalibrationError

_HEADERS: Final = ("Joint", "From", "To", "Speed", "Acceleration")


def build(page: Page, views: Views) -> None:
    with page.panel("Robot", "installation-panel"), ui.element("div").classes("facts"):
        page.fact("Model", lambda s: s.model.title if s.model else "-")
        page.fact("Serial number", _query(page, views, dashboard.SERIAL_NUMBER, str)).props("data-testid=serial")
        page.fact("PolyScope", lambda s: str(s.version or "-"))
        page.fact("Series", lambda s: s.version.series.value if s.version else "-")
        page.fact("Controller box", lambda s: _arm(s, lambda arm: mode_name(ControllerBox, arm.controller_box)))
        page.fact("Masterboard", lambda s: _arm(s, lambda arm: str(arm.masterboard_version)))
        page.fact("Robot type", lambda s: _arm(s, lambda arm: f"{arm.robot_type}, sub type {arm.sub_type}"))
        page.fact("Address", lambda s: s.robot_ip)
        page.fact("Reach", lambda s: f"{1000 * s.model.reach_m:.0f} mm" if s.model else "-")
        page.fact("Payload", lambda s: f"{s.model.payload_max_kg:g} kg" if s.model else "-")
    with ui.column().classes("installation-column"):
        with page.panel("Joint limits", "installation-panel"):
            table = ui.element("div").classes("limits")
            page.live.effect(lambda station: station.core.configuration, lambda arm: _show_limits(table, arm))
        _calibration_panel(page)
    with page.panel("Safety", "installation-panel"):
        with ui.element("div").classes("facts"):
            page.fact("Safety mode", lambda s: s.situation.safety)
            checksum = page.fact("Checksum", board_text(lambda board: f"{board.safety_checksum:08X}"))
            checksum.props("data-testid=checksum")
            page.fact("Reduced mode", board_text(lambda board: "yes" if board.reduced_mode else "no"))
            mode = _query(page, views, dashboard.OPERATIONAL_MODE, lambda mode: mode.value.lower())
            page.fact("Operational mode", mode)
            remote = _query(page, views, dashboard.IS_IN_REMOTE_CONTROL, lambda on: "remote" if on else "local")
            page.fact("Control", remote)
        ui.label(
            "Safety limits, planes and safety I/O are not published by a robot: they are on its own teach pendant, "
            "and the checksum there must be this one."
        ).classes("soft")


def _arm(station: Station, read: Callable[[ConfigurationData], str]) -> str:
    arm = station.core.configuration
    return "-" if arm is None else read(arm)


def _query(page: Page, views: Views, operation: Operation[Any], text: Callable[[Any], str]) -> Callable[[Station], str]:
    """The answer of a dashboard operation, queried each time the view becomes visible."""
    answer = ["-"]

    async def query() -> None:
        try:
            answer[0] = text(await page.station.request(operation))
        except RobotRefused:
            answer[0] = "not reported by this version"

    page.live.effect(
        lambda station: station.connected and views.visible_view == "arm",
        lambda visible: page.run_in_background(query) if visible else None,
    )
    return lambda station: answer[0]


# limits


def _show_limits(table: ui.element, arm: ConfigurationData | None) -> None:
    table.clear()
    if arm is None:
        return
    with table:
        for header in _HEADERS:
            ui.label(header).classes("soft")
        rows = zip(JOINT_TITLES, arm.q_min, arm.q_max, arm.qd_max, arm.qdd_max, strict=True)
        for name, low, high, speed, acceleration in rows:
            ui.label(name)
            ui.label(f"{math.degrees(low):.0f}°")
            ui.label(f"{math.degrees(high):.0f}°")
            ui.label(f"{math.degrees(speed):.0f}°/s")
            ui.label(f"{math.degrees(acceleration):.0f}°/s²")


# calibration


def _calibration_panel(page: Page) -> None:
    with page.panel("Calibration", "installation-panel"):
        with ui.element("div").classes("facts"):
            page.fact("Kinematics", _cached(_calibration_kind)).props("data-testid=calibration")
            page.fact("Hash", _cached(lambda calibration, arm: calibration.hash)).props("data-testid=hash")

        async def save() -> None:
            kinematics = page.station.core.kinematics
            if kinematics is None:
                raise ValueError("this robot has not reported its calibration")
            content = await asyncio.to_thread(_calibration_file, calibration_of(kinematics))
            ui.download.content(content, "my_robot_calibration.yaml")

        ui.button("Download", icon="download", on_click=page.handler(save)).props(
            "flat no-caps data-testid=calibration-file"
        ).tooltip("In the format of ROS's ur_description: my_robot_calibration.yaml")


def _calibration_kind(calibration: Calibration, arm: ConfigurationData) -> str:
    return "nominal" if is_nominal(calibration, arm) else "calibrated"


def _cached(read: Callable[[Calibration, ConfigurationData], str]) -> Callable[[Station], str]:
    """A text that is computed again only when the robot has reported something new."""
    last: list[tuple[KinematicsInfo | None, ConfigurationData | None]] = []
    text = ["-"]

    def read_text(station: Station) -> str:
        inputs = (station.core.kinematics, station.core.configuration)
        if not last or last[0][0] is not inputs[0] or last[0][1] is not inputs[1]:
            last[:] = [inputs]
            text[0] = _calibration_text(*inputs, read)
        return text[0]

    return read_text


def _calibration_text(
    kinematics: KinematicsInfo | None,
    arm: ConfigurationData | None,
    read: Callable[[Calibration, ConfigurationData], str],
) -> str:
    if kinematics is None or arm is None:
        return "-"
    try:
        return read(calibration_of(kinematics), arm)
    except CalibrationError as error:
        return str(error)


def _calibration_file(calibration: Calibration) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "calibration.yaml")
        write_calibration(path, calibration)
        return path.read_bytes()
