"""Digital signals: a lamp each; outputs switch, and the inputs of an emulator too."""

from collections.abc import Callable

from nicegui import ui

from client.pendant.page import Page
from client.pendant.station import Station
from client.pendant.wires import CONFIGURABLE, STANDARD, Group, set_digital

__all__ = ["SIMULATED", "build", "inputs", "outputs"]

SIMULATED = "simulated: touch to change"


def build(page: Page) -> None:
    """The control box's."""
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
    """Say on an emulator that these can be changed, which on a robot they cannot."""
    ui.label(SIMULATED).classes("simulated-mark")
    page.live.bind(panel, "state", lambda station: "simulated" if station.behind.available else "real")


def inputs(page: Page, group: Group) -> None:
    """Lamps of a group."""
    station = page.station

    async def switch(index: int) -> None:
        if station.behind.available:
            level = not _level(station, "actual_digital_input_bits", group, index)
            await page.attempt(
                lambda: station.behind.call("set_digital_input", index=index, level=level, group=group.name)
            )

    _lamps(page, group, "I", "actual_digital_input_bits", switch)


def outputs(page: Page, group: Group) -> None:
    """Lamps of a group that switch."""
    station = page.station

    async def switch(index: int) -> None:
        level = not _level(station, "actual_digital_output_bits", group, index)
        await page.attempt(lambda: set_digital(station, group, index, level))

    _lamps(page, group, "O", "actual_digital_output_bits", switch)


def _lamps(page: Page, group: Group, way: str, field: str, switch: Callable[[int], object]) -> None:
    with ui.element("div").classes(f"wires {'wires-in' if way == 'I' else 'wires-out'}") as row:
        for index in range(group.count):
            name = f"{group.letter}{way}{index}"
            lamp = ui.element("button").classes("wire").props(f"data-testid={name} type=button")
            lamp.on("click", lambda _, index=index: switch(index))
            with lamp:
                ui.element("i")
                ui.label(name)
    page.live.bind(row, "bits", _reader(field, group))


def _reader(field: str, group: Group) -> Callable[[Station], str]:
    def read(station: Station) -> str:
        """A digit each, 0 or 1, in order; "" while they are not known."""
        if field not in station.values:
            return ""
        bits = station.values[field] >> group.first
        return "".join("1" if bits >> index & 1 else "0" for index in range(group.count))

    return read


def _level(station: Station, field: str, group: Group, index: int) -> bool:
    return bool(station.values.get(field, 0) >> group.first + index & 1)
