"""The inputs of an emulator: switches and voltages."""

from collections.abc import Callable
from typing import Any, Final, NamedTuple

from nicegui import ui

from client.pendant.page import Page
from client.pendant.station import Station
from urproto.modes import AnalogDomain

_MAX_VALUES: Final = {AnalogDomain.VOLTAGE: 10.0, AnalogDomain.CURRENT: 20.0}  # V, mA
_MA: Final = 1e3


class _Group(NamedTuple):
    name: str
    title: str
    prefix: str
    size: int
    first_bit: int


class _Analog(NamedTuple):
    title: str
    number: int
    tool: bool
    field: str
    domains: str


_GROUPS: Final = (
    _Group("standard", "Digital inputs", "DI", 8, 0),
    _Group("configurable", "Configurable inputs", "CI", 8, 8),
    _Group("tool", "Tool inputs", "TI", 2, 16),
)
_ANALOG: Final = (
    _Analog("AI0", 0, False, "standard_analog_input0", "analog_io_types"),
    _Analog("AI1", 1, False, "standard_analog_input1", "analog_io_types"),
    _Analog("Tool AI0", 0, True, "tool_analog_input0", "tool_analog_input_types"),
    _Analog("Tool AI1", 1, True, "tool_analog_input1", "tool_analog_input_types"),
)


def inputs_tab(page: Page) -> None:
    """Add the tab to the page."""
    with ui.element("div").classes("sim-stack"):
        for group in _GROUPS:
            ui.label(group.title).classes("panel-title")
            with ui.element("div").classes("sim-bits"):
                for index in range(group.size):
                    _bit_button(page, group, index)
        ui.label("Analog inputs").classes("panel-title")
        for analog in _ANALOG:
            _analog_slider(page, analog)


def _bit_button(page: Page, group: _Group, index: int) -> None:
    bit = 1 << (group.first_bit + index)

    def level(station: Station) -> bool:
        return bool(int(station.values.get("actual_digital_input_bits", 0)) & bit)

    async def toggle() -> None:
        level_wanted = not level(page.station)
        await page.station.emulator.change("set_digital_input", index=index, level=level_wanted, group=group.name)

    with (
        ui.element("button")
        .classes("sim-bit")
        .props(f"type=button data-testid={group.prefix.lower()}{index}") as button
    ):
        ui.element("span").classes("sim-bit-lamp")
        ui.label(f"{group.prefix}{index}")
    button.on("click", page.handler(toggle))
    page.live.bind(button, "state", lambda station: "on" if level(station) else "off")


def _analog_slider(page: Page, analog: _Analog) -> None:
    emulator = page.station.emulator

    async def set_input(value: float, domain: AnalogDomain, *, also_domain: bool = False) -> None:
        arguments: dict[str, Any] = {"domain": domain.name.lower()} if also_domain else {}
        si = value / _MA if domain is AnalogDomain.CURRENT else value
        await emulator.change("set_analog_input", index=analog.number, value=si, tool=analog.tool, **arguments)

    with ui.element("div").classes("sim-analog"):
        ui.label(analog.title).classes("sim-analog-name")
        slider = ui.slider(min=0.0, max=10.0, step=0.01).props(
            f'data-testid=analog-{_test_id(analog)} aria-label="{analog.title}"'
        )
        page.live.text(_value_text(analog), "sim-analog-value").props(f"data-testid=analog-text-{_test_id(analog)}")
        choice = ui.toggle({1: "V", 0: "mA"}, value=1).props("dense unelevated no-caps toggle-color=primary")
    slider.on("change", lambda: page.attempt(lambda: set_input(slider.value, _domain(page.station, analog))))
    choice.on(
        "update:model-value", lambda: page.attempt(lambda: set_input(0.0, AnalogDomain(choice.value), also_domain=True))
    )

    def show(state: tuple[float, AnalogDomain]) -> None:
        value, domain = state
        slider._props["max"] = _MAX_VALUES[domain]
        slider.update()
        slider.set_value(value)
        choice.set_value(int(domain))

    page.live.effect(lambda station: (_value(station, analog), _domain(station, analog)), show)


def _test_id(analog: _Analog) -> str:
    return analog.title.lower().replace(" ", "-")


def _domain(station: Station, analog: _Analog) -> AnalogDomain:
    return AnalogDomain(int(station.values.get(analog.domains, 0b11)) >> analog.number & 1)


def _value(station: Station, analog: _Analog) -> float:
    """The value in V or mA."""
    value = float(station.values.get(analog.field, 0.0))
    return round(_MA * value if _domain(station, analog) is AnalogDomain.CURRENT else value, 2)


def _value_text(analog: _Analog) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        unit = "mA" if _domain(station, analog) is AnalogDomain.CURRENT else "V"
        return f"{_value(station, analog):.2f} {unit}"

    return read
