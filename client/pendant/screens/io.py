"""I/O: digital signals as lamps and switches, analog signals, the tool; views of registers and of the Modbus server."""

from collections.abc import Callable
from typing import Any, Final

from nicegui import ui

from client.pendant.outputs import Range, analog_range, set_analog, set_digital
from client.pendant.page import Page, Views, bind_choice
from client.pendant.screens import io_registers
from client.pendant.station import Station
from urproto.modes import AnalogDomain, ToolDigitalOutputMode, ToolMode, ToolOutputMode, mode_name
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
_DOMAINS: Final = {int(AnalogDomain.CURRENT): "mA", int(AnalogDomain.VOLTAGE): "V"}


def build_tool(page: Page) -> None:
    """The panel of the tool."""
    with page.panel("Tool", "tool-panel") as panel:
        simulated(page, panel)
        with ui.row().classes("tool-wires"):
            inputs(page, TOOL)
            outputs(page, TOOL)
        for index in range(2):
            _tool_analog_input(page, index)
        _tool_voltage(page)
        with ui.element("div").classes("facts"):
            _fact(page, "Current", lambda s: _number_text(s, "tool_output_current", "A", 3))
            _fact(page, "Temperature", lambda s: _number_text(s, "tool_temperature", "°C", 1))
            _fact(page, "Mode", _mode_text)
            _fact(page, "Serial line", _serial_line_text)
        _pin_mode_row(page)


def build_supply(page: Page) -> None:
    """Voltages and currents of the control box and the arm."""
    with page.panel("Supply", "power-panel"), ui.element("div").classes("supply-facts"):
        _fact(page, "Main", lambda s: _number_text(s, "actual_main_voltage", "V", 1))
        _fact(page, "Arm", lambda s: _number_text(s, "actual_robot_voltage", "V", 1))
        _fact(page, "Arm current", lambda s: _number_text(s, "actual_robot_current", "A", 2))
        _fact(page, "I/O current", _io_current)


def _io_current(station: Station) -> str:
    state = station.primary_state
    return "-" if state is None or state.masterboard is None else f"{1000 * state.masterboard.io_current:.0f} mA"


def _tool_analog_input(page: Page, index: int) -> None:
    def domain(station: Station) -> int:
        return int(station.values.get("tool_analog_input_types", 0) >> index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"tool_analog_input{index}")

    def value_text(station: Station) -> str:
        amount, signal_range = value(station), analog_range(domain(station))
        return "-" if amount is None else f"{amount * signal_range.factor:.3f} {signal_range.unit}"

    with ui.row().classes("analog"):
        ui.label(f"AI{index + 2}").classes("signal-name")
        page.live.text(value_text, "reading").props(f"data-testid=AI{index + 2}")
        domain_choice(
            page,
            domain,
            lambda chosen: page.station.run_statements(f"set_tool_analog_input_domain({index}, {chosen})"),
            f"AI{index + 2}",
        )
        simulated_input(page, index, value, domain, tool=True)


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


def _fact(page: Page, name: str, read: Callable[[Station], str]) -> None:
    ui.label(name)
    page.live.text(read)


def _number_text(station: Station, field: str, unit: str, digits: int) -> str:
    value = station.values.get(field)
    return "-" if value is None else f"{value:.{digits}f} {unit}"


def _mode_text(station: Station) -> str:
    value = station.values.get("tool_mode")
    return "-" if value is None else mode_name(ToolMode, value).replace("_", " ").capitalize()


def _serial_line_text(station: Station) -> str:
    state = station.primary_state
    line = None if state is None else state.tool_communication
    if line is None:
        return "-"
    if not line.enabled:
        return "off"
    return f"{line.baud_rate} baud, {_PARITIES.get(line.parity, line.parity)}, {line.stop_bits} stop bits"


def build_digital(page: Page) -> None:
    """The digital signals of the control box."""
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
    station = page.station

    async def switch(index: int) -> None:
        if station.emulator.available:
            level = not _level(station, "actual_digital_input_bits", group, index)
            await page.attempt(
                lambda: station.emulator.call("set_digital_input", index=index, level=level, group=group.name)
            )

    _signal_row(page, group, "I", "actual_digital_input_bits", switch)


def outputs(page: Page, group: DigitalGroup) -> None:
    """The output lamps of a group, which are also switches."""
    station = page.station

    async def switch(index: int) -> None:
        level = not _level(station, "actual_digital_output_bits", group, index)
        await page.attempt(lambda: set_digital(station, group, index, level))

    _signal_row(page, group, "O", "actual_digital_output_bits", switch)


def _signal_row(page: Page, group: DigitalGroup, direction: str, field: str, switch: Callable[[int], object]) -> None:
    with ui.element("div").classes(f"wires {'wires-in' if direction == 'I' else 'wires-out'}") as row:
        for index in range(group.count):
            name = f"{group.letter}{direction}{index}"
            lamp = ui.element("button").classes("wire").props(f"data-testid={name} type=button")
            lamp.on("click", lambda _, index=index: switch(index))
            with lamp:
                ui.element("i")
                ui.label(name)
    page.live.bind(row, "bits", _bits_reader(field, group))


def _bits_reader(field: str, group: DigitalGroup) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        """A digit for each signal, 0 or 1, in order; "" while unknown."""
        if field not in station.values:
            return ""
        bits = station.values[field] >> group.first
        return "".join("1" if bits >> index & 1 else "0" for index in range(group.count))

    return read


def _level(station: Station, field: str, group: DigitalGroup, index: int) -> bool:
    return bool(station.values.get(field, 0) >> group.first + index & 1)


def build_analog(page: Page) -> None:
    """The two analog inputs and outputs of the control box."""
    with page.panel("Analog inputs", "analog-panel") as panel:
        simulated(page, panel)
        for index in range(2):
            _analog_input(page, index)
    with page.panel("Analog outputs", "analog-panel"):
        for index in range(2):
            _analog_output(page, index)


def _analog_input(page: Page, index: int) -> None:
    station = page.station

    def domain(station: Station) -> int:
        return int(station.values.get("analog_io_types", 0) >> index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"standard_analog_input{index}")

    with ui.row().classes("analog"):
        ui.label(f"AI{index}").classes("signal-name")
        page.live.text(_value_text(value, domain), "reading").props(f"data-testid=AI{index}")
        domain_choice(
            page,
            domain,
            lambda chosen: station.run_statements(f"set_standard_analog_input_domain({index}, {chosen})"),
            f"AI{index}",
        ).props(f"data-testid=AI{index}-domain")
        simulated_input(page, index, value, domain)


def _analog_output(page: Page, index: int) -> None:
    station = page.station

    def domain(station: Station) -> int:
        return int(station.values.get("analog_io_types", 0) >> 2 + index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"standard_analog_output{index}")

    async def set_value(shown: float) -> None:
        chosen = AnalogDomain(domain(station))
        await page.attempt(lambda: set_analog(station, index, chosen, analog_range(chosen).ratio(shown)))

    async def change(chosen: int) -> None:
        ratio = _ratio(value(station), analog_range(domain(station)))
        await set_analog(station, index, AnalogDomain(chosen), ratio)

    with ui.row().classes("analog"):
        ui.label(f"AO{index}").classes("signal-name")
        page.live.text(_value_text(value, domain), "reading").props(f"data-testid=AO{index}")
        domain_choice(page, domain, change, f"AO{index}").props(f"data-testid=AO{index}-domain")
        _slider(page, set_value, value, domain, f"AO{index}")
        _number_field(set_value, f"AO{index}").props(f"data-testid=AO{index}-value")


def domain_choice(page: Page, read: Callable[[Station], int], choose: Callable[[int], Any], name: str) -> ui.toggle:
    """A choice of mA or V that follows the robot."""
    toggle = ui.toggle(_DOMAINS).props("dense no-caps unelevated").classes("domain")
    bind_choice(page, toggle, lambda station: read(station) if station.connected else None, choose, f"domain of {name}")
    return toggle


def simulated_input(
    page: Page,
    index: int,
    value: Callable[[Station], float | None],
    domain: Callable[[Station], int],
    tool: bool = False,
) -> None:
    """A slider for an emulator's analog input."""
    station = page.station

    async def set_value(shown: float) -> None:
        amount = shown / analog_range(domain(station)).factor
        await page.attempt(lambda: station.emulator.call("set_analog_input", index=index, value=amount, tool=tool))

    name = f"AI{index + 2 * tool}"
    _slider(page, set_value, value, domain, name).classes("simulated-only")


def _slider(
    page: Page,
    set_value: Callable[[float], Any],
    value: Callable[[Station], float | None],
    domain: Callable[[Station], int],
    name: str,
) -> ui.slider:
    """A slider over the signal's range that follows the robot."""
    slider = ui.slider(min=0, max=1000, step=1).props("dense").classes("analog-slider")
    slider.props(f"aria-label={name} data-testid={name}-slider")

    async def move() -> None:
        signal_range = analog_range(domain(page.station))
        await set_value(signal_range.low + (signal_range.high - signal_range.low) * slider.value / 1000)

    slider.on("change", move)
    page.live.effect(
        lambda station: round(1000 * _ratio(value(station), analog_range(domain(station)))), slider.set_value
    )
    return slider


def _number_field(set_value: Callable[[float], Any], name: str) -> ui.number:
    """A field whose value is set with Enter."""
    box = ui.number(format="%.3f", placeholder="set").props("dense outlined hide-bottom-space").classes("analog-value")
    box.props(f"aria-label={name}")

    async def submit() -> None:
        if box.value is not None:
            await set_value(box.value)

    box.on("keydown.enter", submit)
    return box


def _ratio(value: float | None, signal_range: Range) -> float:
    if value is None:
        return 0.0
    return min(max((value * signal_range.factor - signal_range.low) / (signal_range.high - signal_range.low), 0.0), 1.0)


def _value_text(value: Callable[[Station], float | None], domain: Callable[[Station], int]) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        amount, signal_range = value(station), analog_range(domain(station))
        return "-" if amount is None else f"{amount * signal_range.factor:.3f} {signal_range.unit}"

    return read


def build(page: Page) -> None:
    """Add the screen to the page."""
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
