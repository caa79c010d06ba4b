"""Initialize: power and brakes, the state of the safety system, payload, and the state of each joint."""

from collections.abc import Callable
from math import ceil, degrees
from typing import Any, Final

from nicegui import ui

from client import dashboard
from client.dashboard_commands import Operation
from client.pendant.page import Page
from client.pendant.situation import STAGES, Action, Tone
from client.pendant.station import Station
from urproto.errorcodes import error_text
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
_AXES: Final = ("CX", "CY", "CZ")
_MM: Final = 1e3
_HOT_C: Final = (60.0, 80.0)  # guess: warm, hot; joints switch off by themselves
_LAMPS: Final[dict[str, Tone]] = {
    "Running": "ready",
    "Idle": "waiting",
    "Booting": "waiting",
    "Violation": "stopped",
    "Fault": "stopped",
}
_UNKNOWN: Final = "–"
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
            _safety_fact(page, "Emergency stop", _emergency_text, "estop-state")
            _safety_fact(page, "Safeguard", safeguard_text, "safeguard-state")
            _safety_fact(page, "Limits", _limits_text, "limits-state")
            _control_fact(page)


def stop_cause(station: Station) -> str:
    """The report that explains the stop, "" without a stop or without a report."""
    mode = station.safety_mode
    if mode is SafetyMode.PROTECTIVE_STOP:
        stop = station.stops.current
        report = None if stop is None else stop.cause
    else:
        report = _last_serious_error(station) if station.situation.recovery_action is Action.RESTART_SAFETY else None
    if report is None:
        return ""
    return f"{report.label}: {report.text.strip() or error_text(report.code, report.argument)}"


def _last_serious_error(station: Station) -> ErrorCodeMessage | None:
    serious = (error for error in reversed(station.core.errors) if error.level % 128 >= ReportLevel.VIOLATION)
    return next(serious, None)


# recovery


def recovery_text(station: Station) -> str:
    """The text of the recovery button."""
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


def _safety_fact(page: Page, name: str, read: Callable[[Station], str], test_id: str) -> None:
    with ui.element("div").classes("init-fact"):
        ui.label(name).classes("init-th")
        page.live.text(read).props(f"data-testid={test_id}")


def _bits(station: Station) -> SafetyStatusBits:
    return SafetyStatusBits(int(station.values.get("safety_status_bits", 0)))


def _emergency_text(station: Station) -> str:
    if not station.connected:
        return _UNKNOWN
    bits = _bits(station)
    return next((text for bit, text in _EMERGENCY_BITS if bits & bit), "Released")


def safeguard_text(station: Station) -> str:
    """The state of an emulator's safeguard; a robot only reports whether the stop is in force."""
    if not station.connected:
        return _UNKNOWN
    stopped = bool(_bits(station) & SafetyStatusBits.SAFEGUARD_STOPPED)
    if station.safeguard_open is None:
        return "Open or not reset" if stopped else "Closed"
    if station.safeguard_open:
        return "Open"
    reset = station.safety_mode is SafetyMode.SAFEGUARD_STOP
    return "Closed, not reset" if reset else "Closed"


def _limits_text(station: Station) -> str:
    if not station.connected:
        return _UNKNOWN
    bits = _bits(station)
    if bits & SafetyStatusBits.RECOVERY:
        return "Recovery"
    return "Reduced" if bits & SafetyStatusBits.REDUCED else "Normal"


def _control_fact(page: Page) -> None:
    """Remote or local control: e-Series robots accept commands from clients or from their own pendant."""
    station = page.station
    with ui.element("div").classes("init-fact") as fact:
        ui.label("Control").classes("init-th")
        page.live.text(_control_text, "").props("data-testid=control-state")
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


Payload = tuple[float, float, float, float]  # kg, mm


def payload_panel(page: Page) -> None:
    """Fields for mass and centre of gravity, which follow the robot, and a button that sets them."""
    with page.panel("Active payload", "init-payload"):
        with ui.element("div").classes("init-payload-fields"):
            mass = _number_field("Mass", "kg", "payload-mass", "%.3f", minimum=0.0, step=0.1)
            cog = [_number_field(axis, "mm", f"payload-{axis.lower()}", "%.1f") for axis in _AXES]
            apply = page.handler(lambda: _apply_payload(page.station, [mass, *cog]), "The payload is set")
            page.needs_robot(ui.button("Set", on_click=apply)).props("unelevated data-testid=payload-set")
        page.live.text(_rated_payload, "init-hint")

    def show(payload: Payload | None) -> None:
        for field, value in zip((mass, *cog), payload or (None,) * 4, strict=True):
            field.set_value(value)

    page.live.effect(_active_payload, show)


def _number_field(
    name: str, unit: str, test_id: str, format_: str, minimum: float | None = None, step: float = 1.0
) -> ui.number:
    field = ui.number(name, format=format_, min=minimum, step=step).props(
        f"outlined dense hide-bottom-space suffix={unit} data-testid={test_id}"
    )
    return field.classes("number")


def _active_payload(station: Station) -> Payload | None:
    mass, cog = station.values.get("payload"), station.values.get("payload_cog")
    if mass is None or cog is None:
        return None
    return (round(mass, 3), *(round(_MM * value, 1) for value in cog))


def _rated_payload(station: Station) -> str:
    model = station.model
    return "" if model is None else f"Rated payload {model.payload_max_kg:g} kg. Centre of gravity from the flange."


async def _apply_payload(station: Station, fields: list[ui.number]) -> None:
    if any(field.value is None for field in fields):
        raise ValueError("The payload needs a mass and three coordinates of its centre of gravity.")
    mass, *cog = (float(field.value) for field in fields)
    await set_payload(station, mass, [value / _MM for value in cog])


async def set_payload(station: Station, mass_kg: float, cog_m: list[float]) -> None:
    """Set the payload in parallel to the running program; on an emulator in local control, by a verb.

    Raises ValueError, ClientError.
    """
    if mass_kg < 0.0:
        raise ValueError(f"The payload cannot be {mass_kg:g} kg: a mass is 0 or more.")
    if station.emulator.available and station.remote_control.value is False:
        await station.emulator.change("set_payload", mass_kg=mass_kg, cog_m=cog_m)
    else:
        await station.run_statements(f"set_payload({mass_kg!r}, {cog_m!r})")


ReadText = Callable[[Station], str]


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
            for name, field, format_ in (
                ("Main voltage", "actual_main_voltage", "{:.1f} V"),
                ("Robot voltage", "actual_robot_voltage", "{:.1f} V"),
                ("Robot current", "actual_robot_current", "{:.2f} A"),
            ):
                _fact(page, name, _scalar_text(field, format_))
            _fact(page, "Control box", _control_box_temperature)
            _fact(page, "Controller up", _uptime_text)


def _joint_row(page: Page, number: int, name: str) -> None:
    _mode_cell(
        page,
        name,
        f"joint-mode-{number}",
        lambda station: _mode_name(JointMode, _element(station, "joint_mode", number)),
    )
    _text_cell(page, _joint_text("actual_q", number, "{:.2f} °", degrees))
    _text_cell(page, _joint_text("actual_qd", number, "{:.1f} °/s", degrees))
    _text_cell(page, _joint_text("actual_current", number, "{:.2f} A"))
    _temperature_cell(page, lambda station: _element(station, "joint_temperatures", number))


def _tool_row(page: Page) -> None:
    _mode_cell(page, "Tool", "tool-mode", lambda station: _mode_name(ToolMode, station.values.get("tool_mode")))
    _text_cell(page, _scalar_text("tool_output_voltage", "{:d} V"))
    _text_cell(page, lambda station: "")
    _text_cell(page, _scalar_text("tool_output_current", "{:.2f} A"))
    _temperature_cell(page, lambda station: station.values.get("tool_temperature"))


def _mode_cell(page: Page, name: str, test_id: str, read: ReadText) -> None:
    ui.label(name).classes("init-joint")
    with ui.element("div").classes("init-cell init-joint-mode"):
        lamp = ui.element("span").classes("lamp")
        page.live.bind(lamp, "state", lambda station: _LAMPS.get(read(station), "unknown"))
        page.live.text(read).props(f"data-testid={test_id}")


def _text_cell(page: Page, read: ReadText) -> None:
    page.live.text(read, "init-cell init-number")


def _temperature_cell(page: Page, read: Callable[[Station], Any]) -> None:
    def text(station: Station) -> str:
        value = read(station)
        return _UNKNOWN if value is None else f"{value:.1f} °C"

    def state(station: Station) -> str:
        value = read(station) or 0.0
        return "hot" if value > _HOT_C[1] else "warm" if value > _HOT_C[0] else "fine"

    with ui.element("div").classes("init-cell init-temperature"):
        page.live.text(text, "init-number")
        with ui.element("div").classes("init-bar"):
            bar = ui.element("div")
            page.live.bind(bar, "width", lambda station: round(100 * min(1.0, (read(station) or 0.0) / _MAX_C)))
            page.live.bind(bar, "state", state)


def _fact(page: Page, name: str, read: ReadText) -> None:
    with ui.element("div").classes("init-fact"):
        ui.label(name).classes("init-th")
        page.live.text(read, "init-number")


def _element(station: Station, field: str, number: int) -> Any:
    values = station.values.get(field)
    return None if values is None else values[number]


def _joint_text(field: str, number: int, format_: str, convert: Callable[[float], float] = float) -> ReadText:
    def read(station: Station) -> str:
        value = _element(station, field, number)
        return _UNKNOWN if value is None else _format_value(format_, convert(value))

    return read


def _scalar_text(field: str, format_: str) -> ReadText:
    def read(station: Station) -> str:
        value = station.values.get(field)
        return _UNKNOWN if value is None else _format_value(format_, value)

    return read


def _format_value(format_: str, value: float) -> str:
    """Format a value without a minus sign before zero."""
    text = format_.format(value)
    return text.removeprefix("-") if text.startswith("-0") and not text.strip("-0. °/sAVC") else text


def _mode_name(modes: type[JointMode] | type[ToolMode], value: Any) -> str:
    if value is None:
        return _UNKNOWN
    try:
        return modes(value).name.replace("_", " ").capitalize()
    except ValueError:  # newer robots may have more modes
        return str(value)


def _control_box_temperature(station: Station) -> str:
    state = station.primary_state
    board = None if state is None else state.masterboard
    return _UNKNOWN if board is None else f"{board.board_temperature:.1f} °C"


def _uptime_text(station: Station) -> str:
    if "timestamp" not in station.values:
        return _UNKNOWN
    seconds = int(station.values["timestamp"])
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


def build(page: Page) -> None:
    """Add the screen to the page."""
    with ui.element("div").classes("initialize"):
        _power_panel(page)
        safety_panel(page)
        joints_panel(page)
        payload_panel(page)


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
    page.live.bind(box, "state", lambda station: _stage_state(station.situation.stage, number))


def _stage_state(current: int, number: int) -> str:
    return "now" if number == current else "done" if number < current else "next"


def _power_button(page: Page, text: str, icon: str, operation: Operation[None], test_id: str, action: Action) -> None:
    button = ui.button(text, icon=icon)
    button.props(f"unelevated stack size=lg data-testid={test_id}").classes(f"init-button {test_id}")
    page.bind_button(action, lambda: page.station.request(operation), button)
