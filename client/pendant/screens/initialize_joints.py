"""The six joints, the tool and the control box: mode, temperature, current, position."""

from collections.abc import Callable
from math import degrees
from typing import Any, Final

from nicegui import ui

from client.pendant.page import Page
from client.pendant.situation import Tone
from client.pendant.station import Station
from urproto.modes import JointMode, ToolMode

__all__ = ["joints_panel"]

_JOINTS: Final = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")
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
            for number, name in enumerate(_JOINTS):
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
