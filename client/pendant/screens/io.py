"""I/O: digital signals as lamps and switches, analog signals, the tool; views of registers and of the Modbus server."""

from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final

from nicegui import ui

from client.pendant.page import Page, Views, bind_choice
from client.pendant.readings import UNKNOWN, board_text, field_text, mode_text
from client.pendant.screens import io_registers
from client.pendant.settings import Range, analog_range, set_analog, set_digital
from client.pendant.station import Station
from urproto.modes import AnalogDomain, ToolDigitalOutputMode, ToolMode, ToolOutputMode
from urproto.signals import CONFIGURABLE, STANDARD, TOOL, DigitalGroup
from urproto.versions import Series

_VOLTAGES: Final = {0: "0 V", 12: "12 V", 24: "24 V"}
_PIN_MODES: Final = {
    int(ToolOutputMode.DIGITAL): "Digital outputs",
    int(ToolOutputMode.DUAL_PIN_POWER): "Dual pin power",
}
_DRIVE_MODES: Final = {
    int(ToolDigitalOutputMode.SINKING_NPN): "Sinking (NPN)",
    int(ToolDigitalOutputMode.SOURCING_PNP): "Sourcing (PNP)",
    int(ToolDigitalOutputMode.PUSH_PULL): "Push / pull",
}
_PARITIES: Final = {0: "no parity", 1: "odd parity", 2: "even parity"}
SIMULATED = "simulated: touch to change"
_STANDARD_DOMAIN: Final = "set_standard_analog_input_domain"
_TOOL_DOMAIN: Final = "set_tool_analog_input_domain"
_DOMAINS: Final = {int(AnalogDomain.CURRENT): "mA", int(AnalogDomain.VOLTAGE): "V"}


@dataclass(frozen=True, slots=True)
class AnalogSignal:
    """An analog input or output. index: of its connector. field: its RTDE output.

    domains: the RTDE output whose bit ``bit`` is its domain. call: the URScript function that sets the domain.
    """

    name: str
    index: int
    field: str
    domains: str
    bit: int
    call: str = ""
    tool: bool = False

    def value(self, station: Station) -> float | None:
        """The value [A or V]; None while unknown."""
        return station.values.get(self.field)

    def domain(self, station: Station) -> AnalogDomain:
        return AnalogDomain(int(station.values.get(self.domains, 0)) >> self.bit & 1)

    def range(self, station: Station) -> Range:
        return analog_range(self.domain(station))

    def ratio(self, station: Station) -> float:
        value, signal_range = self.value(station), self.range(station)
        if value is None:
            return 0.0
        share = (value * signal_range.factor - signal_range.low) / (signal_range.high - signal_range.low)
        return min(max(share, 0.0), 1.0)

    def text(self, station: Station) -> str:
        value, signal_range = self.value(station), self.range(station)
        return UNKNOWN if value is None else f"{value * signal_range.factor:.3f} {signal_range.unit}"


ANALOG_INPUTS: Final = (
    AnalogSignal("AI0", 0, "standard_analog_input0", "analog_io_types", 0, _STANDARD_DOMAIN),
    AnalogSignal("AI1", 1, "standard_analog_input1", "analog_io_types", 1, _STANDARD_DOMAIN),
    AnalogSignal("AI2", 0, "tool_analog_input0", "tool_analog_input_types", 0, _TOOL_DOMAIN, tool=True),
    AnalogSignal("AI3", 1, "tool_analog_input1", "tool_analog_input_types", 1, _TOOL_DOMAIN, tool=True),
)
_ANALOG_OUTPUTS: Final = (
    AnalogSignal("AO0", 0, "standard_analog_output0", "analog_io_types", 2),
    AnalogSignal("AO1", 1, "standard_analog_output1", "analog_io_types", 3),
)


def build_tool(page: Page) -> None:
    with page.panel("Tool", "tool-panel") as panel:
        simulated(page, panel)
        with ui.row().classes("tool-wires"):
            inputs(page, TOOL)
            outputs(page, TOOL)
        for signal in ANALOG_INPUTS:
            if signal.tool:
                analog_input(page, signal)
        _tool_voltage(page)
        with ui.element("div").classes("facts"):
            page.fact("Current", field_text("tool_output_current", "{:.3f} A"))
            page.fact("Temperature", field_text("tool_temperature", "{:.1f} °C"))
            page.fact("Mode", mode_text("tool_mode", ToolMode))
            page.fact("Serial line", _serial_line_text)
        _pin_mode_row(page)


def build_supply(page: Page) -> None:
    with page.panel("Supply", "power-panel"), ui.element("div").classes("supply-facts"):
        page.fact("Main", field_text("actual_main_voltage", "{:.1f} V"))
        page.fact("Arm", field_text("actual_robot_voltage", "{:.1f} V"))
        page.fact("Arm current", field_text("actual_robot_current", "{:.2f} A"))
        page.fact("I/O current", board_text(lambda board: f"{1000 * board.io_current:.0f} mA"))


def _tool_voltage(page: Page) -> None:
    with ui.row().classes("analog tool-supply"):
        ui.label("Supply").classes("signal-name")
        toggle = ui.toggle(_VOLTAGES).props("dense no-caps unelevated").props("data-testid=tool-voltage")
    bind_choice(
        page,
        toggle,
        lambda station: station.values.get("tool_output_voltage"),
        lambda chosen: page.station.run_statements(f"set_tool_voltage({chosen})"),
        "tool voltage",
    )


def _pin_mode_row(page: Page) -> None:
    """The modes of the output pins, which can be chosen on e-Series."""
    with ui.row().classes("tool-uses") as row:
        _pin_mode_select(page, _PIN_MODES, "Output pins", "output_mode", "set_tool_output_mode({})").props(
            "data-testid=tool-use"
        )
        for index in range(2):
            call = f"set_tool_digital_output_mode({index}, {{}})"
            _pin_mode_select(page, _DRIVE_MODES, f"TO{index}", f"digital_output{index}_mode", call)
    page.live.effect(lambda station: station.version is None or station.version.series is Series.E, row.set_visibility)


def _pin_mode_select(page: Page, options: dict[int, str], label: str, name: str, call: str) -> ui.select:
    select = ui.select(options, label=label).props("dense outlined options-dense")

    async def choose(chosen: int) -> None:
        await page.station.run_statements(call.format(chosen))

    bind_choice(page, select, lambda station: _pin_mode(station, name), choose, label)
    return select


def _pin_mode(station: Station, name: str) -> int | None:
    state = station.primary_state
    return None if state is None or state.tool_mode is None else getattr(state.tool_mode, name)


def _serial_line_text(station: Station) -> str:
    state = station.primary_state
    line = None if state is None else state.tool_communication
    if line is None:
        return UNKNOWN
    if not line.enabled:
        return "off"
    return f"{line.baud_rate} baud, {_PARITIES.get(line.parity, line.parity)}, {line.stop_bits} stop bits"


def build_digital(page: Page) -> None:
    with page.panel("Digital inputs", "wire-panel") as panel:
        simulated(page, panel)
        for group in (STANDARD, CONFIGURABLE):
            ui.label(group.name.capitalize()).classes("caption")
            inputs(page, group)
    with page.panel("Digital outputs", "wire-panel"):
        for group in (STANDARD, CONFIGURABLE):
            ui.label(group.name.capitalize()).classes("caption")
            outputs(page, group)


def simulated(page: Page, panel: ui.element) -> None:
    """Show on an emulator that these inputs can be changed, unlike on a robot."""
    ui.label(SIMULATED).classes("simulated-mark")
    page.live.bind(panel, "state", lambda station: "simulated" if station.emulator.available else "real")


def inputs(page: Page, group: DigitalGroup) -> None:
    """The input lamps of a group; on an emulator, they are switches."""
    emulator = page.station.emulator

    async def switch(index: int, level: bool) -> None:
        if emulator.available:
            await emulator.call("set_digital_input", index=index, level=level, group=group.name)

    _signal_row(page, group, "I", "actual_digital_input_bits", switch)


def outputs(page: Page, group: DigitalGroup) -> None:
    """The output lamps of a group, which are also switches."""
    _signal_row(page, group, "O", "actual_digital_output_bits", partial(set_digital, page.station, group))


def _signal_row(
    page: Page, group: DigitalGroup, direction: str, field: str, switch: Callable[[int, bool], Awaitable[None]]
) -> None:
    """switch: sets the level of a signal."""

    def read(station: Station) -> str:
        """A digit for each signal, 0 or 1, in order; "" while unknown."""
        if field not in station.values:
            return ""
        bits = station.values[field] >> group.first
        return "".join(str(bits >> index & 1) for index in range(group.count))

    def toggle(index: int) -> Awaitable[None]:
        return switch(index, read(page.station)[index : index + 1] != "1")

    with ui.element("div").classes(f"wires {'wires-in' if direction == 'I' else 'wires-out'}") as row:
        for index in range(group.count):
            name = f"{group.letter}{direction}{index}"
            lamp = ui.element("button").classes("wire").props(f"data-testid={name} type=button")
            lamp.on("click", page.handler(partial(toggle, index)))
            with lamp:
                ui.element("i")
                ui.label(name)
    page.live.bind(row, "bits", read)


def build_analog(page: Page) -> None:
    """The two analog inputs and outputs of the control box."""
    with page.panel("Analog inputs", "analog-panel") as panel:
        simulated(page, panel)
        for signal in ANALOG_INPUTS:
            if not signal.tool:
                analog_input(page, signal)
    with page.panel("Analog outputs", "analog-panel"):
        for signal in _ANALOG_OUTPUTS:
            _analog_output(page, signal)


def analog_input(page: Page, signal: AnalogSignal) -> None:
    """An analog input; on an emulator, a slider sets it."""
    station = page.station

    async def set_value(shown: float) -> None:
        value = shown / signal.range(station).factor
        await station.emulator.call("set_analog_input", index=signal.index, value=value, tool=signal.tool)

    with _analog_row(page, signal, lambda chosen: station.run_statements(f"{signal.call}({signal.index}, {chosen})")):
        _slider(page, signal, set_value).classes("simulated-only")


def _analog_output(page: Page, signal: AnalogSignal) -> None:
    station = page.station

    async def set_value(shown: float) -> None:
        await set_analog(station, signal.index, signal.domain(station), signal.range(station).ratio(shown))

    async def change(chosen: int) -> None:
        await set_analog(station, signal.index, AnalogDomain(chosen), signal.ratio(station))

    with _analog_row(page, signal, change):
        _slider(page, signal, set_value)
        box = ui.number(format="%.3f", placeholder="set").props("dense outlined hide-bottom-space")
        box.classes("analog-value").props(f"aria-label={signal.name} data-testid={signal.name}-value")
        box.on("keydown.enter", page.handler(lambda: None if box.value is None else set_value(box.value)))


@contextmanager
def _analog_row(page: Page, signal: AnalogSignal, choose: Callable[[int], Awaitable[None]]) -> Iterator[None]:
    """The name and value of a signal, and a choice of mA or V that follows the robot."""
    with ui.row().classes("analog"):
        ui.label(signal.name).classes("signal-name")
        page.live.text(signal.text, "reading").props(f"data-testid={signal.name}")
        toggle = ui.toggle(_DOMAINS).props(f"dense no-caps unelevated data-testid={signal.name}-domain")
        toggle.classes("domain")
        domain = f"domain of {signal.name}"
        bind_choice(page, toggle, lambda s: int(signal.domain(s)) if s.connected else None, choose, domain)
        yield


def _slider(page: Page, signal: AnalogSignal, set_value: Callable[[float], Awaitable[None]]) -> ui.slider:
    """A slider over the signal's range that follows the robot."""
    slider = ui.slider(min=0, max=1000, step=1).props("dense").classes("analog-slider")
    slider.props(f"aria-label={signal.name} data-testid={signal.name}-slider")

    async def move() -> None:
        signal_range = signal.range(page.station)
        await set_value(signal_range.low + (signal_range.high - signal_range.low) * slider.value / 1000)

    slider.on("change", page.handler(move))
    page.live.effect(lambda station: round(1000 * signal.ratio(station)), slider.set_value)
    return slider


def build(page: Page) -> None:
    titles = {"signals": "Robot", "registers": "Registers", "modbus": "Modbus"}
    with ui.column().classes("io"), Views(page, "io", titles) as views:
        with views.view("signals", "io-signals"):
            build_digital(page)
            build_analog(page)
            build_tool(page)
            build_supply(page)
        with views.view("registers"):
            io_registers.build(page, views)
        with views.view("modbus"):
            io_registers.build_modbus(page, views)
