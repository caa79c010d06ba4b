"""Initialize: power and brakes, what the safety system says, payload, and the state of every joint."""

from collections.abc import Callable
from typing import Final

from nicegui import ui

from client import dashboard
from client.operations import Operation
from client.pendant.page import Page
from client.pendant.screens.initialize_joints import joints_panel
from client.pendant.screens.initialize_payload import payload_panel
from client.pendant.screens.initialize_safety import safety_panel
from client.pendant.station import Station
from urproto.modes import RobotMode, SafetyMode

__all__ = ["build", "may_switch_on", "stage"]

_STAGES: Final = ("Power off", "Booting", "Idle", "Normal")
_OFF, _BOOTING, _IDLE, _NORMAL = range(len(_STAGES))
_AT: Final = {
    RobotMode.POWER_OFF: _OFF,
    RobotMode.BOOTING: _BOOTING,
    RobotMode.POWER_ON: _BOOTING,
    RobotMode.IDLE: _IDLE,
    RobotMode.BACKDRIVE: _IDLE,
    RobotMode.RUNNING: _NORMAL,
}
_HINTS: Final = {
    RobotMode.NO_CONTROLLER: "The controller is not there yet.",
    RobotMode.DISCONNECTED: "The controller is not connected to the arm.",
    RobotMode.CONFIRM_SAFETY: "The safety configuration has to be confirmed on the robot's own pendant.",
    RobotMode.BOOTING: "The joints start.",
    RobotMode.POWER_OFF: "The arm has no power. ON gives it power, START releases the brakes too.",
    RobotMode.POWER_ON: "The arm has power.",
    RobotMode.IDLE: "The brakes hold the arm. START releases them; look that nobody is near.",
    RobotMode.BACKDRIVE: "The arm can be pushed away by hand.",
    RobotMode.RUNNING: "The brakes are released: the arm can move.",
    RobotMode.UPDATING_FIRMWARE: "The joints get new firmware.",
}
_STOPPED_HARD: Final = frozenset(
    {
        SafetyMode.ROBOT_EMERGENCY_STOP,
        SafetyMode.SYSTEM_EMERGENCY_STOP,
        SafetyMode.IMMI_EMERGENCY_STOP,
        SafetyMode.PROFISAFE_EMERGENCY_STOP,
        SafetyMode.VIOLATION,
        SafetyMode.FAULT,
    }
)


def stage(mode: RobotMode) -> int:
    """How far the arm has come: 0 is off, 3 is ready; -1 when there is nothing to switch on."""
    return _AT.get(mode, -1)


def may_switch_on(station: Station) -> bool:
    """The arm is there, and no stop keeps it off."""
    return station.connected and stage(station.robot_mode) >= _OFF and station.safety_mode not in _STOPPED_HARD


def build(page: Page) -> None:
    """Put it on the page."""
    with ui.element("div").classes("initialize"):
        _power_panel(page)
        safety_panel(page)
        joints_panel(page)
        payload_panel(page)


def _power_panel(page: Page) -> None:
    live = page.live
    with page.panel("Robot", "init-power"), ui.element("div").classes("init-power-row"):
        with ui.element("div").classes("init-status"):
            lamp = ui.element("div").classes("init-lamp")
            live.bind(lamp, "state", _lamp)
            with ui.element("div").classes("init-status-text"):
                live.text(_headline, "init-mode").props("data-testid=robot-mode")
                live.text(_hint, "init-hint")
        with ui.element("div").classes("init-stages"):
            for number, name in enumerate(_STAGES):
                _stage(page, number, name)
        with ui.element("div").classes("init-buttons"):
            _button(page, "On", "power", dashboard.POWER_ON, "power-on", _wants_power)
            _button(page, "Start", "lock_open", dashboard.BRAKE_RELEASE, "brake-release", _wants_start)
            _button(page, "Off", "power_settings_new", dashboard.POWER_OFF, "power-off", _is_on)


def _stage(page: Page, number: int, name: str) -> None:
    with ui.element("div").classes("init-stage") as box:
        ui.element("span").classes("init-stage-dot")
        ui.label(name).classes("init-stage-name")
    page.live.bind(box, "state", lambda station: _progress(stage(station.robot_mode), number))


def _progress(now: int, number: int) -> str:
    return "now" if number == now else "done" if number < now else "next"


def _button(
    page: Page, text: str, icon: str, operation: Operation[None], mark: str, wanted: Callable[[Station], bool]
) -> None:
    button = ui.button(text, icon=icon, on_click=page.doing(lambda: page.station.ask(operation)))
    button.props(f"unelevated stack size=lg data-testid={mark}").classes(f"init-button {mark}")
    page.live.effect(wanted, button.set_enabled)


def _wants_power(station: Station) -> bool:
    return may_switch_on(station) and stage(station.robot_mode) == _OFF


def _wants_start(station: Station) -> bool:
    return may_switch_on(station) and stage(station.robot_mode) in (_OFF, _IDLE)


def _is_on(station: Station) -> bool:
    return station.connected and stage(station.robot_mode) > _OFF


def _headline(station: Station) -> str:
    now = stage(station.robot_mode)
    if not station.connected:
        return "Not connected"
    return _STAGES[now] if now >= 0 else station.robot_mode.name.replace("_", " ").capitalize()


def _hint(station: Station) -> str:
    if station.connected and stage(station.robot_mode) == _OFF and station.safety_mode in _STOPPED_HARD:
        return "A stop keeps the arm switched off: see Safety."
    return _HINTS.get(station.robot_mode, "")


def _lamp(station: Station) -> str:
    now = stage(station.robot_mode)
    if not station.connected or now <= _OFF:
        return "off"
    if station.safety_mode not in (SafetyMode.NORMAL, SafetyMode.REDUCED):
        return "stopped"
    return "ready" if now == _NORMAL else "waiting"
