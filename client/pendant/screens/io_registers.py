"""The registers shared by programs and clients: Booleans, integers and doubles, inputs and outputs, in parts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from nicegui import ui

from client.modbus import GENERAL_REGISTERS
from client.pendant.feeds import Feed
from client.pendant.page import Page, Views
from client.pendant.station import Station

_FORMATS: dict[str, Callable[[int], str]] = {
    "unsigned": str,
    "signed": lambda word: str(word - 0x10000 if word & 0x8000 else word),
    "hex": lambda word: f"{word:04X}",
}
CELLS: Final = 24  # visible integers and doubles per direction
_BITS: Final = 64
_RATE_HZ: Final = 10.0
_LOWER: Final = "fieldbus"  # the half that RTDE clients share with a fieldbus
_UPPER: Final = "clients"  # the half reserved for RTDE clients


def build_modbus(page: Page, views: Views) -> None:
    registers = page.station.general_registers
    format_ = ["unsigned"]

    def words() -> tuple[int, ...]:
        return registers.words if views.visible_view == "modbus" else ()

    async def edit(index: int) -> None:
        address = GENERAL_REGISTERS[index]
        current = dict(enumerate(words())).get(index)
        value = await request_number(page, f"Modbus register {address}", current, whole=True)
        if value is not None:
            await page.attempt(lambda: registers.write(address, to_word(value)))

    with ui.row().classes("register-choice"):
        ui.toggle(
            {"unsigned": "Unsigned", "signed": "Signed", "hex": "Hexadecimal"},
            value=format_[0],
            on_change=lambda change: format_.__setitem__(0, change.value),
        ).props("no-caps unelevated data-testid=modbus-form")
        page.live.text(lambda station: station.general_registers.problem or _server_address(station), "soft")
    title = "General purpose registers: touch one to write it"
    with page.panel(title, "register-panel"), ui.element("div").classes("cells modbus-cells") as grid:
        for index, address in enumerate(GENERAL_REGISTERS):
            cell = ui.element("button").classes("cell").props(f"data-testid=modbus-{address} type=button")
            cell.on("click", lambda _, index=index: edit(index))
            with cell:
                ui.element("i")
                ui.label("")
    page.live.bind(grid, "cells", lambda _: _modbus_cells(words(), format_[0]))


def _server_address(station: Station) -> str:
    return f"Modbus/TCP server at {station.robot_ip}:{station.ports['modbus']}"


def _modbus_cells(words: Sequence[int], format_: str) -> Any:
    write = _FORMATS[format_]
    return [GENERAL_REGISTERS[0], list(map(write, words)) or ["-"] * len(GENERAL_REGISTERS)]


def to_word(value: float) -> int:
    """A register's 16 bits for a number from -32768 to 65535. Raises ValueError."""
    if value != int(value) or not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"a Modbus register cannot hold {value:g}: it has whole numbers from -32768 to 65535")
    return int(value) & 0xFFFF


@dataclass(frozen=True, slots=True)
class Bank:
    """The visible registers: their type, and the lower or the upper half."""

    kind: str = "int"
    half: str = _UPPER

    @property
    def first(self) -> int:
        return 0 if self.half == _LOWER else _BITS if self.kind == "bit" else CELLS

    @property
    def count(self) -> int:
        return _BITS if self.kind == "bit" else CELLS

    def fields(self, direction: str) -> tuple[str, ...]:
        """RTDE variables of ``input`` or ``output`` registers; the lower booleans are two words."""
        if self.kind == "bit" and self.half == _LOWER:
            return f"{direction}_bit_registers0_to_31", f"{direction}_bit_registers32_to_63"
        return tuple(f"{direction}_{self.kind}_register_{self.first + index}" for index in range(self.count))

    def levels(self, direction: str, values: Mapping[str, Any]) -> str:
        """A digit for each boolean, 0 or 1, or a dash if unknown."""
        found = [values.get(field) for field in self.fields(direction)]
        if self.half == _LOWER:
            bits = [None if word is None else word >> bit & 1 for word in found for bit in range(32)]
        else:
            bits = found
        return "".join("-" if bit is None else str(int(bit)) for bit in bits)

    def texts(self, direction: str, values: Mapping[str, Any]) -> list[str]:
        found = [values.get(field) for field in self.fields(direction)]
        return ["-" if value is None else f"{value:.6g}" if self.kind == "double" else str(value) for value in found]

    def input_values(self, index: int, value: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """The RTDE inputs that set one register. Raises ValueError if the value does not fit."""
        if self.kind == "bit" and self.half == _LOWER:
            field, bit = self.fields("input")[index // 32], index % 32
            word = values.get(field, 0)
            return {field: word | 1 << bit if value else word & ~(1 << bit)}
        field = self.fields("input")[index]
        if self.kind == "bit":
            return {field: bool(value)}
        if self.kind == "double":
            return {field: float(value)}
        if value != int(value) or not -(2**31) <= value < 2**31:
            raise ValueError(f"an integer register cannot hold {value:g}: it has whole numbers of 32 bits")
        return {field: int(value)}


class _Registers:
    """The registers on one page: the visible bank, and its states."""

    def __init__(self, page: Page, views: Views) -> None:
        self.page = page
        self.bank = Bank()
        self.feed: Feed | None = None
        self._views = views
        views.on_view_change.append(lambda view: self.update_feed())

    def update_feed(self) -> None:
        """Subscribe to the visible registers only."""
        feeds, previous = self.page.station.feeds, self.feed
        visible = self._views.visible_view == "registers"
        names = (*self.bank.fields("input"), *self.bank.fields("output"))
        self.feed = feeds.subscribe(names, _RATE_HZ) if visible else None
        if previous is not None:
            feeds.unsubscribe(previous)

    def choose(self, **changes: Any) -> None:
        self.bank = Bank(**{"kind": self.bank.kind, "half": self.bank.half, **changes})
        self.update_feed()

    @property
    def values(self) -> Mapping[str, Any]:
        return {} if self.feed is None else self.feed.values

    async def edit(self, index: int) -> None:
        """Switch an input boolean, or request the number of an input register."""
        bank, values = self.bank, self.values
        if bank.kind == "bit":
            level = bank.levels("input", values)[index] != "1"
            await self._write(bank, index, level)
            return
        name = bank.fields("input")[index]
        value = await request_number(self.page, name, values.get(name), whole=bank.kind == "int")
        if value is not None:
            await self._write(bank, index, value)

    async def _write(self, bank: Bank, index: int, value: Any) -> None:
        async def write() -> None:
            await self.page.station.write(**bank.input_values(index, value, self.values))

        await self.page.attempt(write)


def build(page: Page, views: Views) -> None:
    registers = _Registers(page, views)
    with ui.row().classes("register-choice"):
        kinds = {"bit": "Boolean", "int": "Integer", "double": "Double"}
        ui.toggle(kinds, value="int", on_change=lambda change: registers.choose(kind=change.value)).props(
            "no-caps unelevated data-testid=register-kind"
        )
        halves = {_LOWER: "Lower (fieldbus and clients)", _UPPER: "Upper (clients)"}
        ui.toggle(halves, value=_UPPER, on_change=lambda change: registers.choose(half=change.value)).props(
            "no-caps unelevated data-testid=register-half"
        )
        page.live.text(lambda station: _problem_text(registers), "soft")
    with ui.row().classes("register-banks"):
        for direction, title in (("input", "Input registers: touch one to write it"), ("output", "Output registers")):
            with page.panel(title, "register-panel"):
                _number_grid(registers, direction)
                _boolean_grid(registers, direction)


def _problem_text(registers: _Registers) -> str:
    feed = registers.feed
    if feed is None or not feed.problem:
        missing = feed is not None and feed.unavailable
        return "this version does not have all of these" if missing else ""
    return feed.problem


def _number_grid(registers: _Registers, direction: str) -> None:
    with ui.element("div").classes("cells") as grid:
        _cells(registers, direction, CELLS, "cell")
    registers.page.live.bind(
        grid, "cells", _cached(registers, lambda bank, v: [bank.first, bank.texts(direction, v)], False)
    )


def _boolean_grid(registers: _Registers, direction: str) -> None:
    with ui.element("div").classes("cells bit-cells") as grid:
        _cells(registers, direction, _BITS, "wire")
    registers.page.live.bind(
        grid, "bits", _cached(registers, lambda bank, v: [bank.first, bank.levels(direction, v)], True)
    )


def _cells(registers: _Registers, direction: str, count: int, style: str) -> None:
    for index in range(count):
        writable = direction == "input"
        with ui.element("button" if writable else "div").classes(style if writable else f"{style} fixed") as cell:
            ui.element("i")
            ui.label("")
        cell.props(f"data-testid={direction}-{style}-{index}")
        if writable:
            cell.props("type=button").on("click", lambda _, index=index: registers.edit(index))


def _cached(
    registers: _Registers, read: Callable[[Bank, Mapping[str, Any]], Any], bits: bool
) -> Callable[[Station], Any]:
    """The value of ``read``, computed once per state; None hides the grid of the other kind."""
    last: list[Any] = [None, None, None]

    def read_cached(station: Station) -> Any:
        bank, values = registers.bank, registers.values
        if bank is not last[0] or values is not last[1]:
            last[:] = bank, values, read(bank, values) if (bank.kind == "bit") is bits else None
        return last[2]

    return read_cached


async def request_number(page: Page, name: str, value: float | None, whole: bool) -> float | None:
    """Request a number from the user; None if cancelled."""

    def field() -> ui.number:
        box = ui.number(value=value, precision=0 if whole else None)
        return box.props(f'autofocus outlined dense data-testid=number aria-label="{name}"')

    answer = await page.request_value(name, field, "Set", "number-set")
    return None if answer is None else float(answer)
