"""Initialize: power and brakes, the state of the safety system, payload, and the state of each joint."""

from math import ceil, degrees
from typing import Final

from nicegui import ui

from client import dashboard
from client.dashboard_commands import Operation
from client.pendant.events import report_level, report_text
from client.pendant.page import Page
from client.pendant.readings import UNKNOWN, ReadText, board_text, field_text, field_value, mode_text
from client.pendant.screens.payload import payload_form
from client.pendant.situation import STAGES, Action, Tone
from client.pendant.station import Station
from urproto.joints import JOINT_TITLES
from urproto.modes import JointMode, ReportLevel, SafetyMode, SafetyStatusBits, ToolMode
from urproto.primary.messages import ErrorCodeMessage

_EMERGENCY_BITS: Final = (
    (SafetyStatusBits.ROBOT_EMERGENCY_STOPPED, "Pressed (robot)"),
    (SafetyStatusBits.SYSTEM_EMERGENCY_STOPPED, "Pressed (system)"),
    (SafetyStatusBits.EMERGENCY_STOPPED, "Pressed"),
)
_RECOVERY_TEXTS: Final = {
    Action.UNLOCK: "Unlock protective stop",
    Action.RESET_SAFEGUARD: "Reset safeguard",
    Action.RESTART_SAFETY: "Restart safety",
}
_HOT_C: Final = (60.0, 80.0)  # guess: warm, hot; joints switch off by themselves
_LAMPS: Final[dict[str, Tone]] = {
    "Running": "ready",
    "Idle": "waiting",
    "Booting": "waiting",
    "Violation": "stopped",
    "Fault": "stopped",
}
_MAX_C: Final = 100.0


def safety_panel(page: Page) -> None:
    """The safety mode with its cause and the recovery button; emergency stop, safeguard, remote or local control."""
    live = page.live
    with page.panel("Safety", "init-safety") as panel:
        live.bind(panel, "state", lambda station: station.situation.safety_tone)
        with ui.element("div").classes("init-safety-row"):
            with ui.element("div").classes("init-safety-text"):
                live.text(lambda station: station.situation.safety, "init-safety-mode").props("data-testid=safety-mode")
                live.text(stop_cause, "init-cause").props("data-testid=safety-cause")
                live.text(lambda station: station.situation.advice, "init-hint").props("data-testid=safety-advice")
            _emergency_button(page)
        _recovery_button(page)
        with ui.element("div").classes("init-facts"):
            _fact(page, "Emergency stop", _emergency_text, "estop-state")
            _fact(page, "Safeguard", safeguard_text, "safeguard-state")
            _fact(page, "Limits", _limits_text, "limits-state")
            _control_fact(page)


def stop_cause(station: Station) -> str:
    """The report that explains the stop, "" without a stop or without a report."""
    mode = station.safety_mode
    if mode is SafetyMode.PROTECTIVE_STOP:
        stop = station.stops.current
        report = None if stop is None else stop.cause
    else:
        report = _last_serious_error(station) if station.situation.recovery_action is Action.RESTART_SAFETY else None
    return "" if report is None else f"{report.label}: {report_text(report)}"


def _last_serious_error(station: Station) -> ErrorCodeMessage | None:
    serious = (error for error in reversed(station.core.errors) if report_level(error) >= ReportLevel.VIOLATION)
    return next(serious, None)


# recovery


def recovery_text(station: Station) -> str:
    recovery_action, wait_s = station.situation.recovery_action, ceil(station.stops.unlock_in_s)
    if recovery_action is Action.UNLOCK and wait_s:
        return f"Unlock in {wait_s} s"
    return "" if recovery_action is None else _RECOVERY_TEXTS[recovery_action]


def _recovery_button(page: Page) -> None:
    button = ui.button(on_click=page.handler(lambda: _recover(page.station)))
    button.props("unelevated icon=lock_reset data-testid=unlock").classes("init-unlock")
    with button:
        page.live.text(recovery_text)
    page.live.bind(button, "title", _recovery_refusal)
    page.show_if(button, lambda station: station.situation.recovery_action is not None)
    page.live.effect(lambda station: not _recovery_refusal(station), button.set_enabled)


def _recovery_refusal(station: Station) -> str:
    situation = station.situation
    return "" if situation.recovery_action is None else situation.refusal(situation.recovery_action)


async def _recover(station: Station) -> None:
    match station.situation.recovery_action:
        case Action.UNLOCK:
            await station.request(dashboard.UNLOCK_PROTECTIVE_STOP)
        case Action.RESTART_SAFETY:
            await station.request(dashboard.RESTART_SAFETY)
        case Action.RESET_SAFEGUARD:
            await station.emulator.change("reset_safeguard")


# buttons and devices


def _emergency_button(page: Page) -> None:
    """The emergency stop button of an emulator."""
    with ui.element("button").classes("estop").props("type=button data-testid=estop") as button:
        ui.label("Emergency").classes("estop-text")
        ui.label("stop").classes("estop-text")
    button.on("click", page.handler(lambda: _toggle_emergency_stop(page.station)))
    page.live.bind(button, "state", lambda station: "pressed" if _is_emergency_pressed(station) else "released")
    page.show_if(button, lambda station: station.emulator.available)


def _is_emergency_pressed(station: Station) -> bool:
    return bool(_bits(station) & SafetyStatusBits.ROBOT_EMERGENCY_STOPPED)


async def _toggle_emergency_stop(station: Station) -> None:
    verb = "release_emergency_stop" if _is_emergency_pressed(station) else "press_emergency_stop"
    await station.emulator.change(verb, button="robot")


def _fact(page: Page, name: str, read: ReadText, test_id: str = "", classes: str = "") -> ui.element:
    with ui.element("div").classes("init-fact") as fact:
        ui.label(name).classes("init-th")
        page.live.text(read, classes).props(f"data-testid={test_id}" if test_id else "")
    return fact


def _bits(station: Station) -> SafetyStatusBits:
    return SafetyStatusBits(int(station.values.get("safety_status_bits", 0)))


def _emergency_text(station: Station) -> str:
    if not station.connected:
        return UNKNOWN
    bits = _bits(station)
    return next((text for bit, text in _EMERGENCY_BITS if bits & bit), "Released")


def safeguard_text(station: Station) -> str:
    """The state of an emulator's safeguard; a robot only reports whether the stop is in force."""
    if not station.connected:
        return UNKNOWN
    stopped = bool(_bits(station) & SafetyStatusBits.SAFEGUARD_STOPPED)
    if station.safeguard_open is None:
        return "Open or not reset" if stopped else "Closed"
    if station.safeguard_open:
        return "Open"
    reset = station.safety_mode is SafetyMode.SAFEGUARD_STOP
    return "Closed, not reset" if reset else "Closed"


def _limits_text(station: Station) -> str:
    if not station.connected:
        return UNKNOWN
    bits = _bits(station)
    if bits & SafetyStatusBits.RECOVERY:
        return "Recovery"
    return "Reduced" if bits & SafetyStatusBits.REDUCED else "Normal"


def _control_fact(page: Page) -> None:
    """Remote or local control: e-Series robots accept commands from clients or from their own pendant."""
    station = page.station
    fact = _fact(page, "Control", _control_text, "control-state")
    page.show_if(fact, lambda s: s.connected and s.remote_control.value is not None)
    with fact:
        button = ui.button(icon="swap_horiz", on_click=page.handler(lambda: _toggle_remote_control(station)))
        button.props(
            "flat round dense size=sm data-testid=remote-control aria-label='Remote or local control'"
        ).tooltip("Remote or local control")
    page.show_if(button, lambda s: s.emulator.available)


def _control_text(station: Station) -> str:
    remote = station.remote_control.value
    return "" if remote is None else "Remote" if remote else "Local"


async def _toggle_remote_control(station: Station) -> None:
    await station.emulator.change("set_remote_control", on=not station.remote_control.value)
    station.remote_control.refresh()


def joints_panel(page: Page) -> None:
    """A row for each joint and one for the tool; the control box below."""
    with page.panel("Joints", "init-joints"):
        with ui.element("div").classes("init-table"):
            for title in ("", "Mode", "Position", "Speed", "Current", "Temperature"):
                ui.label(title).classes("init-th")
            for number, name in enumerate(JOINT_TITLES):
                _joint_row(page, number, name)
            _tool_row(page)
        with ui.element("div").classes("init-box"):
            for name, read in (
                ("Main voltage", field_text("actual_main_voltage", "{:.1f} V")),
                ("Robot voltage", field_text("actual_robot_voltage", "{:.1f} V")),
                ("Robot current", field_text("actual_robot_current", "{:.2f} A")),
                ("Control box", board_text(lambda board: f"{board.board_temperature:.1f} °C")),
                ("Controller up", _uptime_text),
            ):
                _fact(page, name, read, classes="init-number")


def _joint_row(page: Page, number: int, name: str) -> None:
    _mode_cell(page, name, f"joint-mode-{number}", mode_text("joint_mode", JointMode, number))
    _text_cell(page, field_text("actual_q", "{:.2f} °", number, degrees))
    _text_cell(page, field_text("actual_qd", "{:.1f} °/s", number, degrees))
    _text_cell(page, field_text("actual_current", "{:.2f} A", number))
    _temperature_cell(page, "joint_temperatures", number)


def _tool_row(page: Page) -> None:
    _mode_cell(page, "Tool", "tool-mode", mode_text("tool_mode", ToolMode))
    _text_cell(page, field_text("tool_output_voltage", "{:d} V"))
    _text_cell(page, lambda station: "")
    _text_cell(page, field_text("tool_output_current", "{:.2f} A"))
    _temperature_cell(page, "tool_temperature")


def _mode_cell(page: Page, name: str, test_id: str, read: ReadText) -> None:
    ui.label(name).classes("init-joint")
    with ui.element("div").classes("init-cell init-joint-mode"):
        lamp = ui.element("span").classes("lamp")
        page.live.bind(lamp, "state", lambda station: _LAMPS.get(read(station), "unknown"))
        page.live.text(read).props(f"data-testid={test_id}")


def _text_cell(page: Page, read: ReadText) -> None:
    page.live.text(read, "init-cell init-number")


def _temperature_cell(page: Page, field: str, index: int | None = None) -> None:
    def celsius(station: Station) -> float:
        return field_value(station, field, index) or 0.0

    def state(station: Station) -> str:
        value = celsius(station)
        return "hot" if value > _HOT_C[1] else "warm" if value > _HOT_C[0] else "fine"

    with ui.element("div").classes("init-cell init-temperature"):
        page.live.text(field_text(field, "{:.1f} °C", index), "init-number")
        with ui.element("div").classes("init-bar"):
            bar = ui.element("div")
            page.live.bind(bar, "width", lambda station: round(100 * min(1.0, celsius(station) / _MAX_C)))
            page.live.bind(bar, "state", state)


def _uptime_text(station: Station) -> str:
    if "timestamp" not in station.values:
        return UNKNOWN
    seconds = int(station.values["timestamp"])
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def build(page: Page) -> None:
    with ui.element("div").classes("initialize"):
        _power_panel(page)
        safety_panel(page)
        joints_panel(page)
        with page.panel("Active payload", "init-payload"):
            payload_form(page, "Set", "payload-set")


def _power_panel(page: Page) -> None:
    live = page.live
    with page.panel("Robot", "init-power"), ui.element("div").classes("init-power-row"):
        with ui.element("div").classes("init-status"):
            lamp = ui.element("div").classes("lamp init-lamp").props("data-testid=robot-lamp")
            live.bind(lamp, "state", lambda station: station.situation.tone)
            with ui.element("div").classes("init-status-text"):
                live.text(lambda station: station.situation.title, "init-mode").props("data-testid=robot-mode")
                live.text(lambda station: station.situation.hint, "init-hint").props("data-testid=robot-hint")
        with ui.element("div").classes("init-stages"):
            for number, name in enumerate(STAGES):
                _stage_box(page, number, name)
        with ui.element("div").classes("init-buttons"):
            _power_button(page, "On", "power", dashboard.POWER_ON, "power-on", Action.POWER_ON)
            _power_button(page, "Start", "lock_open", dashboard.BRAKE_RELEASE, "brake-release", Action.RELEASE_BRAKES)
            _power_button(page, "Off", "power_settings_new", dashboard.POWER_OFF, "power-off", Action.POWER_OFF)


def _stage_box(page: Page, number: int, name: str) -> None:
    with ui.element("div").classes("init-stage") as box:
        ui.element("span").classes("init-stage-dot")
        ui.label(name).classes("init-stage-name")

    def state(station: Station) -> str:
        current = station.situation.stage
        return "now" if number == current else "done" if number < current else "next"

    page.live.bind(box, "state", state)


def _power_button(page: Page, text: str, icon: str, operation: Operation[None], test_id: str, action: Action) -> None:
    button = ui.button(text, icon=icon)
    button.props(f"unelevated stack size=lg data-testid={test_id}").classes(f"init-button {test_id}")
    page.bind_button(action, lambda: page.station.request(operation), button)
