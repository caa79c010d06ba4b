"""What the safety system says, why, and what leads on from there."""

from collections.abc import Callable
from math import ceil
from typing import Final

from nicegui import ui

from client import dashboard
from client.pendant.page import Page
from client.pendant.station import Station
from urproto.errorcodes import error_text
from urproto.modes import ReportLevel, SafetyMode, SafetyStatusBits
from urproto.primary.messages import ErrorCodeMessage

__all__ = ["advice", "cause", "reset_text", "safety_panel", "way_out"]

_GOOD: Final = (SafetyMode.NORMAL, SafetyMode.REDUCED)
_EMERGENCY: Final = (
    SafetyMode.ROBOT_EMERGENCY_STOP,
    SafetyMode.SYSTEM_EMERGENCY_STOP,
    SafetyMode.IMMI_EMERGENCY_STOP,
    SafetyMode.PROFISAFE_EMERGENCY_STOP,
)
_HARD: Final = (SafetyMode.VIOLATION, SafetyMode.FAULT)
_GATES: Final = "Close the safeguard; where a reset button is wired, press it. The program goes on then."
_HELD: Final = "Hold the enabling device in its middle position."
_ADVICE: Final = {
    SafetyMode.NORMAL: "Nothing keeps the arm from moving.",
    SafetyMode.REDUCED: "The limits of reduced mode are in force.",
    SafetyMode.PROTECTIVE_STOP: "Look for the cause and remove it, then unlock. The program stays paused.",
    SafetyMode.RECOVERY: "The arm is outside its limits: move it back on Move, or by freedrive.",
    SafetyMode.SAFEGUARD_STOP: _GATES,
    SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP: _GATES,
    SafetyMode.IMMI_SAFEGUARD_STOP: _GATES,
    SafetyMode.PROFISAFE_SAFEGUARD_STOP: _GATES,
    SafetyMode.PROFISAFE_AUTOMATIC_MODE_SAFEGUARD_STOP: _GATES,
    SafetyMode.SAFETY_API_SAFEGUARD_STOP: _GATES,
    SafetyMode.PROFISAFE_WAITING_FOR_PARAMETERS: "The PROFIsafe controller has not sent its parameters yet.",
    SafetyMode.SYSTEM_THREE_POSITION_ENABLING_STOP: _HELD,
    SafetyMode.TP_THREE_POSITION_ENABLING_STOP: _HELD,
    SafetyMode.SYSTEM_EMERGENCY_STOP: "Release the emergency stop of the other machine, then ON and START.",
    SafetyMode.VIOLATION: "A safety limit was broken. Find out why, restart the safety system, then ON and START.",
    SafetyMode.FAULT: "The robot found a fault in itself. Remove it, restart the safety system, then ON and START.",
    SafetyMode.VALIDATE_JOINT_ID: "A joint was exchanged: confirm it on the robot's own pendant.",
}
_BUTTON: Final = "Release the emergency stop button (turn it), then ON and START."
_EMERGENCY_BITS: Final = (
    (SafetyStatusBits.ROBOT_EMERGENCY_STOPPED, "Pressed (robot)"),
    (SafetyStatusBits.SYSTEM_EMERGENCY_STOPPED, "Pressed (system)"),
    (SafetyStatusBits.EMERGENCY_STOPPED, "Pressed"),
)


def safety_panel(page: Page) -> None:
    """The safety mode with its cause and the button that leads on; emergency stop, safeguard, who is in control."""
    live = page.live
    with page.panel("Safety", "init-safety") as panel:
        live.bind(panel, "state", lambda station: _colour(station.safety_mode))
        with ui.element("div").classes("init-safety-row"):
            with ui.element("div").classes("init-safety-text"):
                live.text(lambda station: _title(station.safety_mode), "init-safety-mode").props(
                    "data-testid=safety-mode"
                )
                live.text(cause, "init-cause").props("data-testid=safety-cause")
                live.text(lambda station: advice(station.safety_mode), "init-hint")
            _emergency_button(page)
        _way_out_button(page)
        with ui.element("div").classes("init-facts"):
            _fact(page, "Emergency stop", _emergency, "estop-state")
            _fact(page, "Safeguard", _safeguard, "safeguard-state")
            _fact(page, "Limits", _limits, "limits-state")
            _control(page)


def _title(mode: SafetyMode) -> str:
    return mode.name.removesuffix("_SAFETY_MODE").replace("_", " ").capitalize()


def _colour(mode: SafetyMode) -> str:
    if mode in _GOOD:
        return "good"
    return "unknown" if mode is SafetyMode.UNDEFINED_SAFETY_MODE else "bad"


def advice(mode: SafetyMode) -> str:
    """What a person can do about it."""
    return _BUTTON if mode in _EMERGENCY and mode not in _ADVICE else _ADVICE.get(mode, "")


def cause(station: Station) -> str:
    """The report that explains the stop, "" when nothing stops the arm or nobody said why."""
    mode = station.safety_mode
    if mode is SafetyMode.PROTECTIVE_STOP:
        stop = station.stops.current
        report = None if stop is None else stop.cause
    else:
        report = _last_grave(station) if mode in _HARD else None
    if report is None:
        return ""
    return f"{report.label}: {report.text.strip() or error_text(report.code, report.argument)}"


def _last_grave(station: Station) -> ErrorCodeMessage | None:
    graves = (error for error in reversed(station.core.errors) if error.level % 128 >= ReportLevel.VIOLATION)
    return next(graves, None)


# the way out


def way_out(station: Station) -> str:
    """Which button leads on: "unlock", "restart" or ""."""
    if not station.connected:
        return ""
    mode = station.safety_mode
    return "unlock" if mode is SafetyMode.PROTECTIVE_STOP else "restart" if mode in _HARD else ""


def reset_text(station: Station) -> str:
    """What that button says."""
    wait_s = station.stops.unlock_in_s
    if way_out(station) == "restart":
        return "Restart safety"
    return f"Unlock in {ceil(wait_s)} s" if wait_s > 0.0 else "Unlock protective stop"


def _way_out_button(page: Page) -> None:
    button = ui.button(on_click=page.doing(lambda: _lead_out(page.station)))
    button.props("unelevated icon=lock_reset data-testid=unlock").classes("init-way-out")
    with button:
        page.live.text(reset_text)
    page.show_if(button, lambda station: bool(way_out(station)))
    page.live.effect(lambda station: bool(way_out(station)) and station.stops.unlock_in_s <= 0.0, button.set_enabled)


async def _lead_out(station: Station) -> None:
    restart = way_out(station) == "restart"
    await station.ask(dashboard.RESTART_SAFETY if restart else dashboard.UNLOCK_PROTECTIVE_STOP)


# buttons and gates


def _emergency_button(page: Page) -> None:
    """An emulator's, since it has no other."""
    with ui.element("button").classes("estop").props("type=button data-testid=estop") as button:
        ui.label("Emergency").classes("estop-text")
        ui.label("stop").classes("estop-text")
    button.on("click", page.doing(lambda: _press(page.station)))
    page.live.bind(button, "state", lambda station: "pressed" if _pressed(station) else "released")
    page.show_if(button, lambda station: station.behind.available)


def _pressed(station: Station) -> bool:
    return bool(_bits(station) & SafetyStatusBits.ROBOT_EMERGENCY_STOPPED)


async def _press(station: Station) -> None:
    verb = "release_emergency_stop" if _pressed(station) else "press_emergency_stop"
    await station.behind.change(verb, button="robot")


def _fact(page: Page, name: str, read: Callable[[Station], str], mark: str) -> None:
    with ui.element("div").classes("init-fact"):
        ui.label(name).classes("init-th")
        page.live.text(read).props(f"data-testid={mark}")


def _bits(station: Station) -> SafetyStatusBits:
    return SafetyStatusBits(int(station.values.get("safety_status_bits", 0)))


def _emergency(station: Station) -> str:
    bits = _bits(station)
    return next((text for bit, text in _EMERGENCY_BITS if bits & bit), "Released")


def _safeguard(station: Station) -> str:
    return "Open" if _bits(station) & SafetyStatusBits.SAFEGUARD_STOPPED else "Closed"


def _limits(station: Station) -> str:
    bits = _bits(station)
    if bits & SafetyStatusBits.RECOVERY:
        return "Recovery"
    return "Reduced" if bits & SafetyStatusBits.REDUCED else "Normal"


def _control(page: Page) -> None:
    """Who may command: e-Series robots are switched between their own pendant and everybody else."""
    station = page.station
    with ui.element("div").classes("init-fact") as fact:
        ui.label("Control").classes("init-th")
        page.live.text(_controlled, "").props("data-testid=control-state")
    page.show_if(fact, lambda s: s.remote_control.value is not None)
    with fact:
        button = ui.button(icon="swap_horiz", on_click=page.doing(lambda: _swap(station)))
        button.props("flat round dense size=sm data-testid=remote-control").tooltip("Remote or local control")
    page.show_if(button, lambda s: s.behind.available)


def _controlled(station: Station) -> str:
    remote = station.remote_control.value
    return "" if remote is None else "Remote" if remote else "Local"


async def _swap(station: Station) -> None:
    await station.behind.change("set_remote_control", on=not station.remote_control.value)
    station.remote_control.refresh()
