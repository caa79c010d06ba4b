"""What the safety system says, why, and what leads on from there."""

from collections.abc import Callable
from math import ceil
from typing import Final

from nicegui import ui

from client import dashboard
from client.pendant.page import Page
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.errorcodes import error_text
from urproto.modes import ReportLevel, SafetyMode, SafetyStatusBits
from urproto.primary.messages import ErrorCodeMessage

__all__ = ["cause", "reset_text", "safeguard", "safety_panel"]

_NOT_TOLD: Final = "–"
_EMERGENCY_BITS: Final = (
    (SafetyStatusBits.ROBOT_EMERGENCY_STOPPED, "Pressed (robot)"),
    (SafetyStatusBits.SYSTEM_EMERGENCY_STOPPED, "Pressed (system)"),
    (SafetyStatusBits.EMERGENCY_STOPPED, "Pressed"),
)


def safety_panel(page: Page) -> None:
    """The safety mode with its cause and the button that leads on; emergency stop, safeguard, who is in control."""
    live = page.live
    with page.panel("Safety", "init-safety") as panel:
        live.bind(panel, "state", lambda station: station.situation.safety_tone)
        with ui.element("div").classes("init-safety-row"):
            with ui.element("div").classes("init-safety-text"):
                live.text(lambda station: station.situation.safety, "init-safety-mode").props("data-testid=safety-mode")
                live.text(cause, "init-cause").props("data-testid=safety-cause")
                live.text(lambda station: station.situation.advice, "init-hint").props("data-testid=safety-advice")
            _emergency_button(page)
        _way_out_button(page)
        with ui.element("div").classes("init-facts"):
            _fact(page, "Emergency stop", _emergency, "estop-state")
            _fact(page, "Safeguard", safeguard, "safeguard-state")
            _fact(page, "Limits", _limits, "limits-state")
            _control(page)


def cause(station: Station) -> str:
    """The report that explains the stop, "" when nothing stops the arm or nobody said why."""
    mode = station.safety_mode
    if mode is SafetyMode.PROTECTIVE_STOP:
        stop = station.stops.current
        report = None if stop is None else stop.cause
    else:
        report = _last_grave(station) if station.situation.way_out is Action.RESTART_SAFETY else None
    if report is None:
        return ""
    return f"{report.label}: {report.text.strip() or error_text(report.code, report.argument)}"


def _last_grave(station: Station) -> ErrorCodeMessage | None:
    graves = (error for error in reversed(station.core.errors) if error.level % 128 >= ReportLevel.VIOLATION)
    return next(graves, None)


# the way out


_WAYS_OUT: Final = {
    Action.UNLOCK: "Unlock protective stop",
    Action.RESET_SAFEGUARD: "Reset safeguard",
    Action.RESTART_SAFETY: "Restart safety",
}


def reset_text(station: Station) -> str:
    """What the button that leads on says."""
    way_out, wait_s = station.situation.way_out, ceil(station.stops.unlock_in_s)
    if way_out is Action.UNLOCK and wait_s:
        return f"Unlock in {wait_s} s"
    return "" if way_out is None else _WAYS_OUT[way_out]


def _way_out_button(page: Page) -> None:
    button = ui.button(on_click=page.doing(lambda: _lead_out(page.station)))
    button.props("unelevated icon=lock_reset data-testid=unlock").classes("init-way-out")
    with button:
        page.live.text(reset_text)
    page.live.bind(button, "title", _why_not_yet)
    page.show_if(button, lambda station: station.situation.way_out is not None)
    page.live.effect(lambda station: not _why_not_yet(station), button.set_enabled)


def _why_not_yet(station: Station) -> str:
    now = station.situation
    return "" if now.way_out is None else now.why_not(now.way_out)


async def _lead_out(station: Station) -> None:
    match station.situation.way_out:
        case Action.UNLOCK:
            await station.ask(dashboard.UNLOCK_PROTECTIVE_STOP)
        case Action.RESTART_SAFETY:
            await station.ask(dashboard.RESTART_SAFETY)
        case Action.RESET_SAFEGUARD:
            await station.behind.change("reset_safeguard")


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
    if not station.connected:
        return _NOT_TOLD
    bits = _bits(station)
    return next((text for bit, text in _EMERGENCY_BITS if bits & bit), "Released")


def safeguard(station: Station) -> str:
    """As it is where an emulator tells; a robot tells only whether its stop is in force."""
    if not station.connected:
        return _NOT_TOLD
    stopped = bool(_bits(station) & SafetyStatusBits.SAFEGUARD_STOPPED)
    if station.safeguard_open is None:
        return "Open or not reset" if stopped else "Closed"
    if station.safeguard_open:
        return "Open"
    reset = station.safety_mode is SafetyMode.SAFEGUARD_STOP
    return "Closed, not reset" if reset else "Closed"


def _limits(station: Station) -> str:
    if not station.connected:
        return _NOT_TOLD
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
    page.show_if(fact, lambda s: s.connected and s.remote_control.value is not None)
    with fact:
        button = ui.button(icon="swap_horiz", on_click=page.doing(lambda: _swap(station)))
        button.props(
            "flat round dense size=sm data-testid=remote-control aria-label='Remote or local control'"
        ).tooltip("Remote or local control")
    page.show_if(button, lambda s: s.behind.available)


def _controlled(station: Station) -> str:
    remote = station.remote_control.value
    return "" if remote is None else "Remote" if remote else "Local"


async def _swap(station: Station) -> None:
    await station.behind.change("set_remote_control", on=not station.remote_control.value)
    station.remote_control.refresh()
