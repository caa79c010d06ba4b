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
            _safety_fact(page, "Emergency stop", _emergency, "estop-state")
            _safety_fact(page, "Safeguard", safeguard, "safeguard-state")
            _safety_fact(page, "Limits", _limits, "limits-state")
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
            await station.emulator.change("reset_safeguard")


# buttons and gates


def _emergency_button(page: Page) -> None:
    """An emulator's, since it has no other."""
    with ui.element("button").classes("estop").props("type=button data-testid=estop") as button:
        ui.label("Emergency").classes("estop-text")
        ui.label("stop").classes("estop-text")
    button.on("click", page.doing(lambda: _press(page.station)))
    page.live.bind(button, "state", lambda station: "pressed" if _pressed(station) else "released")
    page.show_if(button, lambda station: station.emulator.available)


def _pressed(station: Station) -> bool:
    return bool(_bits(station) & SafetyStatusBits.ROBOT_EMERGENCY_STOPPED)


async def _press(station: Station) -> None:
    verb = "release_emergency_stop" if _pressed(station) else "press_emergency_stop"
    await station.emulator.change(verb, button="robot")


def _safety_fact(page: Page, name: str, read: Callable[[Station], str], mark: str) -> None:
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
    page.show_if(button, lambda s: s.emulator.available)


def _controlled(station: Station) -> str:
    remote = station.remote_control.value
    return "" if remote is None else "Remote" if remote else "Local"


async def _swap(station: Station) -> None:
    await station.emulator.change("set_remote_control", on=not station.remote_control.value)
    station.remote_control.refresh()


_AXES: Final = ("CX", "CY", "CZ")
_MM: Final = 1e3
Payload = tuple[float, float, float, float]  # kg, mm


def payload_panel(page: Page) -> None:
    """Mass and centre of gravity: fields that follow the robot when it has others, and a button that sets them."""
    with page.panel("Active payload", "init-payload"):
        with ui.element("div").classes("init-payload-fields"):
            mass = _field("Mass", "kg", "payload-mass", "%.3f", least=0.0, step=0.1)
            cog = [_field(axis, "mm", f"payload-{axis.lower()}", "%.1f") for axis in _AXES]
            ui.button("Set", on_click=page.doing(lambda: _set(page.station, [mass, *cog]), "The payload is set")).props(
                "unelevated data-testid=payload-set"
            )
        page.live.text(_most, "init-hint")

    def show(payload: Payload | None) -> None:
        for field, value in zip((mass, *cog), payload or (None,) * 4, strict=True):
            field.set_value(value)

    page.live.effect(_active, show)


def _field(name: str, unit: str, mark: str, form: str, least: float | None = None, step: float = 1.0) -> ui.number:
    field = ui.number(name, format=form, min=least, step=step).props(
        f"outlined dense hide-bottom-space suffix={unit} data-testid={mark}"
    )
    return field.classes("number")


def _active(station: Station) -> Payload | None:
    mass, cog = station.values.get("payload"), station.values.get("payload_cog")
    if mass is None or cog is None:
        return None
    return (round(mass, 3), *(round(_MM * value, 1) for value in cog))


def _most(station: Station) -> str:
    model = station.model
    return "" if model is None else f"Rated payload {model.payload_max_kg:g} kg. Centre of gravity from the flange."


async def _set(station: Station, fields: list[ui.number]) -> None:
    if any(field.value is None for field in fields):
        raise ValueError("The payload needs a mass and three coordinates of its centre of gravity.")
    mass, *cog = (float(field.value) for field in fields)
    await set_payload(station, mass, [value / _MM for value in cog])


async def set_payload(station: Station, mass_kg: float, cog_m: list[float]) -> None:
    """Beside whatever program runs; an emulator in local control has a verb for it. Raises ValueError, ClientError."""
    if mass_kg < 0.0:
        raise ValueError(f"The payload cannot be {mass_kg:g} kg: a mass is 0 or more.")
    if station.emulator.available and station.remote_control.value is False:
        await station.emulator.change("set_payload", mass_kg=mass_kg, cog_m=cog_m)
    else:
        await station.say(f"set_payload({mass_kg!r}, {cog_m!r})")


_HOT_C: Final = (60.0, 80.0)  # guess: warm, hot; joints switch off by themselves
_LAMPS: Final[dict[str, Tone]] = {
    "Running": "ready",
    "Idle": "waiting",
    "Booting": "waiting",
    "Violation": "stopped",
    "Fault": "stopped",
}
_NOT_TOLD: Final = "–"
_MOST_C: Final = 100.0
Text = Callable[[Station], str]


def joints_panel(page: Page) -> None:
    """A row for each joint and one for the tool; the control box below."""
    with page.panel("Joints", "init-joints"):
        with ui.element("div").classes("init-table"):
            for title in ("", "Mode", "Position", "Speed", "Current", "Temperature"):
                ui.label(title).classes("init-th")
            for number, name in enumerate(JOINT_TITLES):
                _joint(page, number, name)
            _tool(page)
        with ui.element("div").classes("init-box"):
            for name, field, form in (
                ("Main voltage", "actual_main_voltage", "{:.1f} V"),
                ("Robot voltage", "actual_robot_voltage", "{:.1f} V"),
                ("Robot current", "actual_robot_current", "{:.2f} A"),
            ):
                _fact(page, name, _scalar(field, form))
            _fact(page, "Control box", _box_temperature)
            _fact(page, "Controller up", _uptime)


def _joint(page: Page, number: int, name: str) -> None:
    _mode(page, name, f"joint-mode-{number}", lambda station: _name(JointMode, _of(station, "joint_mode", number)))
    _cell(page, _item("actual_q", number, "{:.2f} °", degrees))
    _cell(page, _item("actual_qd", number, "{:.1f} °/s", degrees))
    _cell(page, _item("actual_current", number, "{:.2f} A"))
    _temperature(page, lambda station: _of(station, "joint_temperatures", number))


def _tool(page: Page) -> None:
    _mode(page, "Tool", "tool-mode", lambda station: _name(ToolMode, station.values.get("tool_mode")))
    _cell(page, _scalar("tool_output_voltage", "{:d} V"))
    _cell(page, lambda station: "")
    _cell(page, _scalar("tool_output_current", "{:.2f} A"))
    _temperature(page, lambda station: station.values.get("tool_temperature"))


def _mode(page: Page, name: str, mark: str, read: Text) -> None:
    ui.label(name).classes("init-joint")
    with ui.element("div").classes("init-cell init-joint-mode"):
        lamp = ui.element("span").classes("lamp")
        page.live.bind(lamp, "state", lambda station: _LAMPS.get(read(station), "unknown"))
        page.live.text(read).props(f"data-testid={mark}")


def _cell(page: Page, read: Text) -> None:
    page.live.text(read, "init-cell init-number")


def _temperature(page: Page, read: Callable[[Station], Any]) -> None:
    def text(station: Station) -> str:
        value = read(station)
        return _NOT_TOLD if value is None else f"{value:.1f} °C"

    def state(station: Station) -> str:
        value = read(station) or 0.0
        return "hot" if value > _HOT_C[1] else "warm" if value > _HOT_C[0] else "fine"

    with ui.element("div").classes("init-cell init-temperature"):
        page.live.text(text, "init-number")
        with ui.element("div").classes("init-bar"):
            bar = ui.element("div")
            page.live.bind(bar, "width", lambda station: round(100 * min(1.0, (read(station) or 0.0) / _MOST_C)))
            page.live.bind(bar, "state", state)


def _fact(page: Page, name: str, read: Text) -> None:
    with ui.element("div").classes("init-fact"):
        ui.label(name).classes("init-th")
        page.live.text(read, "init-number")


def _of(station: Station, field: str, number: int) -> Any:
    values = station.values.get(field)
    return None if values is None else values[number]


def _item(field: str, number: int, form: str, convert: Callable[[float], float] = float) -> Text:
    def read(station: Station) -> str:
        value = _of(station, field, number)
        return _NOT_TOLD if value is None else _shown(form, convert(value))

    return read


def _scalar(field: str, form: str) -> Text:
    def read(station: Station) -> str:
        value = station.values.get(field)
        return _NOT_TOLD if value is None else _shown(form, value)

    return read


def _shown(form: str, value: float) -> str:
    """Without a minus before what is shown as nothing."""
    text = form.format(value)
    return text.removeprefix("-") if text.startswith("-0") and not text.strip("-0. °/sAVC") else text


def _name(modes: type[JointMode] | type[ToolMode], value: Any) -> str:
    if value is None:
        return _NOT_TOLD
    try:
        return modes(value).name.replace("_", " ").capitalize()
    except ValueError:  # newer robots may have more
        return str(value)


def _box_temperature(station: Station) -> str:
    state = station.primary_state
    board = None if state is None else state.masterboard
    return _NOT_TOLD if board is None else f"{board.board_temperature:.1f} °C"


def _uptime(station: Station) -> str:
    if "timestamp" not in station.values:
        return _NOT_TOLD
    seconds = int(station.values["timestamp"])
    return f"{seconds // 3600}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"


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
            lamp = ui.element("div").classes("lamp init-lamp").props("data-testid=robot-lamp")
            live.bind(lamp, "state", lambda station: station.situation.tone)
            with ui.element("div").classes("init-status-text"):
                live.text(lambda station: station.situation.title, "init-mode").props("data-testid=robot-mode")
                live.text(lambda station: station.situation.hint, "init-hint").props("data-testid=robot-hint")
        with ui.element("div").classes("init-stages"):
            for number, name in enumerate(STAGES):
                _stage(page, number, name)
        with ui.element("div").classes("init-buttons"):
            _button(page, "On", "power", dashboard.POWER_ON, "power-on", Action.POWER_ON)
            _button(page, "Start", "lock_open", dashboard.BRAKE_RELEASE, "brake-release", Action.RELEASE_BRAKES)
            _button(page, "Off", "power_settings_new", dashboard.POWER_OFF, "power-off", Action.POWER_OFF)


def _stage(page: Page, number: int, name: str) -> None:
    with ui.element("div").classes("init-stage") as box:
        ui.element("span").classes("init-stage-dot")
        ui.label(name).classes("init-stage-name")
    page.live.bind(box, "state", lambda station: _progress(station.situation.stage, number))


def _progress(now: int, number: int) -> str:
    return "now" if number == now else "done" if number < now else "next"


def _button(page: Page, text: str, icon: str, operation: Operation[None], mark: str, action: Action) -> None:
    button = ui.button(text, icon=icon)
    button.props(f"unelevated stack size=lg data-testid={mark}").classes(f"init-button {mark}")
    page.button_for(action, lambda: page.station.ask(operation), button)
