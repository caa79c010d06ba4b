"""Analog signals of the control box: value, domain; outputs can be set, and the inputs of an emulator too."""

from collections.abc import Callable
from typing import Any, Final

from nicegui import ui

from client.pendant.choices import choice
from client.pendant.page import Page
from client.pendant.screens.io_digital import simulated
from client.pendant.station import Station
from client.pendant.wires import Range, analog_range, set_analog
from urproto.modes import AnalogDomain

__all__ = ["build", "domain_choice", "simulated_input"]

_DOMAINS: Final = {int(AnalogDomain.CURRENT): "mA", int(AnalogDomain.VOLTAGE): "V"}


def build(page: Page) -> None:
    """Two inputs, two outputs."""
    with page.panel("Analog inputs", "analog-panel") as panel:
        simulated(page, panel)
        for index in range(2):
            _input(page, index)
    with page.panel("Analog outputs", "analog-panel"):
        for index in range(2):
            _output(page, index)


def _input(page: Page, index: int) -> None:
    station = page.station

    def domain(station: Station) -> int:
        return int(station.values.get("analog_io_types", 0) >> index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"standard_analog_input{index}")

    with ui.row().classes("analog"):
        ui.label(f"AI{index}").classes("signal-name")
        page.live.text(_shown(value, domain), "reading").props(f"data-testid=AI{index}")
        domain_choice(
            page,
            domain,
            lambda wanted: station.say(f"set_standard_analog_input_domain({index}, {wanted})"),
            f"AI{index}",
        ).props(f"data-testid=AI{index}-domain")
        simulated_input(page, index, value, domain)


def _output(page: Page, index: int) -> None:
    station = page.station

    def domain(station: Station) -> int:
        return int(station.values.get("analog_io_types", 0) >> 2 + index & 1)

    def value(station: Station) -> float | None:
        return station.values.get(f"standard_analog_output{index}")

    async def put(shown: float) -> None:
        wanted = AnalogDomain(domain(station))
        await page.attempt(lambda: set_analog(station, index, wanted, analog_range(wanted).ratio(shown)))

    async def change(wanted: int) -> None:
        ratio = _ratio(value(station), analog_range(domain(station)))
        await set_analog(station, index, AnalogDomain(wanted), ratio)

    with ui.row().classes("analog"):
        ui.label(f"AO{index}").classes("signal-name")
        page.live.text(_shown(value, domain), "reading").props(f"data-testid=AO{index}")
        domain_choice(page, domain, change, f"AO{index}").props(f"data-testid=AO{index}-domain")
        _setter(page, put, value, domain).props(f"data-testid=AO{index}-slider")
        _typed(put).props(f"data-testid=AO{index}-value")


def domain_choice(page: Page, read: Callable[[Station], int], choose: Callable[[int], Any], name: str) -> ui.toggle:
    """mA or V; follows the robot."""
    toggle = ui.toggle(_DOMAINS).props("dense no-caps unelevated").classes("domain")
    choice(page, toggle, lambda station: read(station) if station.connected else None, choose, f"domain of {name}")
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

    async def put(shown: float) -> None:
        amount = shown / analog_range(domain(station)).factor
        await page.attempt(lambda: station.behind.call("set_analog_input", index=index, value=amount, tool=tool))

    slider = _setter(page, put, value, domain).classes("simulated-only")
    slider.props(f"data-testid=AI{index + 2 * tool}-slider")


def _setter(
    page: Page,
    put: Callable[[float], Any],
    value: Callable[[Station], float | None],
    domain: Callable[[Station], int],
) -> ui.slider:
    """A slider over the signal's range that follows the robot."""
    slider = ui.slider(min=0, max=1000, step=1).props("dense").classes("analog-slider")

    async def move() -> None:
        reach = analog_range(domain(page.station))
        await put(reach.low + (reach.high - reach.low) * slider.value / 1000)

    slider.on("change", move)
    page.live.effect(
        lambda station: round(1000 * _ratio(value(station), analog_range(domain(station)))), slider.set_value
    )
    return slider


def _typed(put: Callable[[float], Any]) -> ui.number:
    """Enter sets it."""
    box = ui.number(format="%.3f", placeholder="set").props("dense outlined hide-bottom-space").classes("analog-value")

    async def enter() -> None:
        if box.value is not None:
            await put(box.value)

    box.on("keydown.enter", enter)
    return box


def _ratio(value: float | None, reach: Range) -> float:
    if value is None:
        return 0.0
    return min(max((value * reach.factor - reach.low) / (reach.high - reach.low), 0.0), 1.0)


def _shown(value: Callable[[Station], float | None], domain: Callable[[Station], int]) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        amount, reach = value(station), analog_range(domain(station))
        return "-" if amount is None else f"{amount * reach.factor:.3f} {reach.unit}"

    return read
