"""The tool flange: digital and analog signals, supply, board."""

from collections.abc import Callable
from typing import Final

from nicegui import ui

from client.pendant.choices import choice
from client.pendant.page import Page
from client.pendant.screens.io_analog import domain_choice, simulated_input
from client.pendant.screens.io_digital import inputs, outputs, simulated
from client.pendant.station import Station
from client.pendant.wires import TOOL, analog_range
from client.scripts import mode_name
from urproto.modes import ToolDigitalOutputMode, ToolMode, ToolOutputMode
from urproto.versions import Series

__all__ = ["build", "power"]

_VOLTAGES: Final = {0: "0 V", 12: "12 V", 24: "24 V"}
_USES: Final = {int(ToolOutputMode.DIGITAL): "Digital outputs", int(ToolOutputMode.DUAL_PIN_POWER): "Dual pin power"}
_DRIVES: Final = {
    int(ToolDigitalOutputMode.SINKING_NPN): "Sinking (NPN)",
    int(ToolDigitalOutputMode.SOURCING_PNP): "Sourcing (PNP)",
    int(ToolDigitalOutputMode.PUSH_PULL): "Push / pull",
}
_PARITIES: Final = {0: "no parity", 1: "odd parity", 2: "even parity"}


def build(page: Page) -> None:
    """Put it on the page."""
    with page.panel("Tool", "tool-panel") as panel:
        simulated(page, panel)
        with ui.row().classes("tool-wires"):
            inputs(page, TOOL)
            outputs(page, TOOL)
        for index in range(2):
            _analog(page, index)
        _voltage(page)
        with ui.element("div").classes("facts"):
            _fact(page, "Current", lambda s: _number(s, "tool_output_current", "A", 3))
            _fact(page, "Temperature", lambda s: _number(s, "tool_temperature", "°C", 1))
            _fact(page, "Mode", _mode)
            _fact(page, "Serial line", _line)
        _uses(page)


def power(page: Page) -> None:
    """What the control box and the arm draw."""
    with page.panel("Supply", "power-panel"), ui.element("div").classes("supply-facts"):
        _fact(page, "Main", lambda s: _number(s, "actual_main_voltage", "V", 1))
        _fact(page, "Arm", lambda s: _number(s, "actual_robot_voltage", "V", 1))
        _fact(page, "Arm current", lambda s: _number(s, "actual_robot_current", "A", 2))
        _fact(page, "I/O current", _io_current)


def _io_current(station: Station) -> str:
    state = station.primary_state
    return "-" if state is None or state.masterboard is None else f"{1000 * state.masterboard.io_current:.0f} mA"


def _analog(page: Page, index: int) -> None:
    def domain(station: Station) -> int:
        return int(station.values.get("tool_analog_input_types", 0) >> index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"tool_analog_input{index}")

    def shown(station: Station) -> str:
        amount, reach = value(station), analog_range(domain(station))
        return "-" if amount is None else f"{amount * reach.factor:.3f} {reach.unit}"

    with ui.row().classes("analog"):
        ui.label(f"AI{index + 2}").classes("signal-name")
        page.live.text(shown, "reading").props(f"data-testid=AI{index + 2}")
        domain_choice(
            page,
            domain,
            lambda wanted: page.station.say(f"set_tool_analog_input_domain({index}, {wanted})"),
            f"AI{index + 2}",
        )
        simulated_input(page, index, value, domain, tool=True)


def _voltage(page: Page) -> None:
    with ui.row().classes("analog tool-supply"):
        ui.label("Supply").classes("signal-name")
        toggle = ui.toggle(_VOLTAGES).props("dense no-caps unelevated").props("data-testid=tool-voltage")
    choice(
        page,
        toggle,
        lambda station: station.values.get("tool_output_voltage"),
        lambda wanted: page.station.say(f"set_tool_voltage({wanted})"),
        "tool voltage",
    )


def _uses(page: Page) -> None:
    """What the output pins are for; an e-Series has a choice."""
    with ui.row().classes("tool-uses") as row:
        _use(page, _USES, "Output pins", "output_mode", "set_tool_output_mode({})").props("data-testid=tool-use")
        for index in range(2):
            call = f"set_tool_digital_output_mode({index}, {{}})"
            _use(page, _DRIVES, f"TO{index}", f"digital_output{index}_mode", call)
    page.live.effect(lambda station: station.version is None or station.version.series is Series.E, row.set_visibility)


def _use(page: Page, options: dict[int, str], label: str, name: str, call: str) -> ui.select:
    select = ui.select(options, label=label).props("dense outlined options-dense")

    async def choose(wanted: int) -> None:
        await page.station.say(call.format(wanted))

    choice(page, select, lambda station: _pins(station, name), choose, label)
    return select


def _pins(station: Station, name: str) -> int | None:
    state = station.primary_state
    return None if state is None or state.tool_mode is None else getattr(state.tool_mode, name)


def _fact(page: Page, name: str, read: Callable[[Station], str]) -> None:
    ui.label(name)
    page.live.text(read)


def _number(station: Station, field: str, unit: str, digits: int) -> str:
    value = station.values.get(field)
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def _mode(station: Station) -> str:
    value = station.values.get("tool_mode")
    return "-" if value is None else mode_name(ToolMode, value).replace("_", " ").capitalize()


def _line(station: Station) -> str:
    state = station.primary_state
    line = None if state is None else state.tool_communication
    if line is None:
        return "-"
    if not line.enabled:
        return "off"
    return f"{line.baud_rate} baud, {_PARITIES.get(line.parity, line.parity)}, {line.stop_bits} stop bits"
