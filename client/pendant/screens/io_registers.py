"""The registers shared by programs and clients: Booleans, integers and doubles, inputs and outputs, in parts."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from nicegui import ui

from client.modbus import GENERAL_REGISTERS
from client.pendant.feeds import Feed
from client.pendant.page import Page, Views
from client.pendant.station import Station

_FORMS: dict[str, Callable[[int], str]] = {
    "unsigned": str,
    "signed": lambda word: str(word - 0x10000 if word & 0x8000 else word),
    "hex": lambda word: f"{word:04X}",
}


def build_modbus(page: Page, views: Views) -> None:
    """Put it on the page."""
    registers = page.station.port_registers
    form = ["unsigned"]

    def words() -> tuple[int, ...]:
        return registers.words if views.looked_at == "modbus" else ()

    async def touch(index: int) -> None:
        address = GENERAL_REGISTERS[index]
        now = dict(enumerate(words())).get(index)
        value = await ask_number(page, f"Modbus register {address}", now, whole=True)
        if value is not None:
            await page.attempt(lambda: registers.write(address, word_of(value)))

    with ui.row().classes("register-choice"):
        ui.toggle(
            {"unsigned": "Unsigned", "signed": "Signed", "hex": "Hexadecimal"},
            value=form[0],
            on_change=lambda change: form.__setitem__(0, change.value),
        ).props("no-caps unelevated data-testid=modbus-form")
        page.live.text(lambda station: station.port_registers.problem or _where(station), "soft")
    title = "General purpose registers: touch one to write it"
    with page.panel(title, "register-panel"), ui.element("div").classes("cells modbus-cells") as grid:
        for index, address in enumerate(GENERAL_REGISTERS):
            cell = ui.element("button").classes("cell").props(f"data-testid=modbus-{address} type=button")
            cell.on("click", lambda _, index=index: touch(index))
            with cell:
                ui.element("i")
                ui.label("")
    page.live.bind(grid, "cells", lambda _: _modbus_cells(words(), form[0]))


def _where(station: Station) -> str:
    return f"Modbus/TCP server at {station.robot_ip}:{station.ports['modbus']}"


def _modbus_cells(words: Sequence[int], form: str) -> Any:
    write = _FORMS[form]
    return [GENERAL_REGISTERS[0], list(map(write, words)) or ["-"] * len(GENERAL_REGISTERS)]


def word_of(value: float) -> int:
    """A register's 16 bits for a number from -32768 to 65535. Raises ValueError."""
    if value != int(value) or not -0x8000 <= value <= 0xFFFF:
        raise ValueError(f"a Modbus register cannot hold {value:g}: it has whole numbers from -32768 to 65535")
    return int(value) & 0xFFFF


CELLS: Final = 24  # integers and doubles in view each way
_BITS: Final = 64
_RATE_HZ: Final = 10.0
_LOW: Final = "fieldbus"  # the half that RTDE clients share with a fieldbus
_HIGH: Final = "clients"  # the half that is theirs


@dataclass(frozen=True, slots=True)
class Bank:
    """The visible registers: their type, and the lower or the upper half."""

    kind: str = "int"
    half: str = _HIGH

    @property
    def first(self) -> int:
        """Index of the first."""
        return 0 if self.half == _LOW else _BITS if self.kind == "bit" else CELLS

    @property
    def count(self) -> int:
        """How many."""
        return _BITS if self.kind == "bit" else CELLS

    def fields(self, way: str) -> tuple[str, ...]:
        """RTDE variables of ``input`` or ``output`` registers; the lower booleans are two words."""
        if self.kind == "bit" and self.half == _LOW:
            return f"{way}_bit_registers0_to_31", f"{way}_bit_registers32_to_63"
        return tuple(f"{way}_{self.kind}_register_{self.first + index}" for index in range(self.count))

    def levels(self, way: str, values: Mapping[str, Any]) -> str:
        """A digit for each boolean, 0 or 1, or a dash for what is not known."""
        found = [values.get(field) for field in self.fields(way)]
        if self.half == _LOW:
            bits = [None if word is None else word >> bit & 1 for word in found for bit in range(32)]
        else:
            bits = found
        return "".join("-" if bit is None else str(int(bit)) for bit in bits)

    def texts(self, way: str, values: Mapping[str, Any]) -> list[str]:
        """Of each number."""
        found = [values.get(field) for field in self.fields(way)]
        return ["-" if value is None else f"{value:.6g}" if self.kind == "double" else str(value) for value in found]

    def input_of(self, index: int, value: Any, values: Mapping[str, Any]) -> dict[str, Any]:
        """What to write over RTDE for one input register. Raises ValueError for what does not fit."""
        if self.kind == "bit" and self.half == _LOW:
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
        views.on_look.append(lambda view: self.look())

    def look(self) -> None:
        """Have the states of what is in view, and of nothing else."""
        feeds, before = self.page.station.feeds, self.feed
        wanted = self._views.looked_at == "registers"
        names = (*self.bank.fields("input"), *self.bank.fields("output"))
        self.feed = feeds.look(names, _RATE_HZ) if wanted else None
        if before is not None:
            feeds.leave(before)

    def choose(self, **changes: Any) -> None:
        self.bank = Bank(**{"kind": self.bank.kind, "half": self.bank.half, **changes})
        self.look()

    @property
    def values(self) -> Mapping[str, Any]:
        """The newest state of these registers."""
        return {} if self.feed is None else self.feed.values

    async def touch(self, index: int) -> None:
        """Switch an input boolean, or ask for the number of an input register."""
        bank, values = self.bank, self.values
        if bank.kind == "bit":
            level = bank.levels("input", values)[index] != "1"
            await self._write(bank, index, level)
            return
        name = bank.fields("input")[index]
        value = await ask_number(self.page, name, values.get(name), whole=bank.kind == "int")
        if value is not None:
            await self._write(bank, index, value)

    async def _write(self, bank: Bank, index: int, value: Any) -> None:
        async def write() -> None:
            await self.page.station.write(**bank.input_of(index, value, self.values))

        await self.page.attempt(write)


def build(page: Page, views: Views) -> None:
    """Put it on the page."""
    registers = _Registers(page, views)
    with ui.row().classes("register-choice"):
        kinds = {"bit": "Boolean", "int": "Integer", "double": "Double"}
        ui.toggle(kinds, value="int", on_change=lambda change: registers.choose(kind=change.value)).props(
            "no-caps unelevated data-testid=register-kind"
        )
        halves = {_LOW: "Lower (fieldbus and clients)", _HIGH: "Upper (clients)"}
        ui.toggle(halves, value=_HIGH, on_change=lambda change: registers.choose(half=change.value)).props(
            "no-caps unelevated data-testid=register-half"
        )
        page.live.text(lambda station: _problem(registers), "soft")
    with ui.row().classes("register-banks"):
        for way, title in (("input", "Input registers: touch one to write it"), ("output", "Output registers")):
            with page.panel(title, "register-panel"):
                _numbers(registers, way)
                _booleans(registers, way)


def _problem(registers: _Registers) -> str:
    feed = registers.feed
    if feed is None or not feed.problem:
        missing = feed is not None and feed.unavailable
        return "this version does not have all of these" if missing else ""
    return feed.problem


def _numbers(registers: _Registers, way: str) -> None:
    with ui.element("div").classes("cells") as grid:
        _cells(registers, way, CELLS, "cell")
    registers.page.live.bind(grid, "cells", _seen(registers, lambda bank, v: [bank.first, bank.texts(way, v)], False))


def _booleans(registers: _Registers, way: str) -> None:
    with ui.element("div").classes("cells bit-cells") as grid:
        _cells(registers, way, _BITS, "wire")
    registers.page.live.bind(grid, "bits", _seen(registers, lambda bank, v: [bank.first, bank.levels(way, v)], True))


def _cells(registers: _Registers, way: str, count: int, style: str) -> None:
    for index in range(count):
        writable = way == "input"
        with ui.element("button" if writable else "div").classes(style if writable else f"{style} fixed") as cell:
            ui.element("i")
            ui.label("")
        cell.props(f"data-testid={way}-{style}-{index}")
        if writable:
            cell.props("type=button").on("click", lambda _, index=index: registers.touch(index))


def _seen(
    registers: _Registers, read: Callable[[Bank, Mapping[str, Any]], Any], bits: bool
) -> Callable[[Station], Any]:
    """What ``read`` gives, worked out once for each state; None hides the grid of the other kind."""
    last: list[Any] = [None, None, None]

    def see(station: Station) -> Any:
        bank, values = registers.bank, registers.values
        if bank is not last[0] or values is not last[1]:
            last[:] = bank, values, read(bank, values) if (bank.kind == "bit") is bits else None
        return last[2]

    return see


async def ask_number(page: Page, name: str, value: float | None, whole: bool) -> float | None:
    """Ask a person for a number; None when there is none."""
    with page.content, ui.dialog() as dialog, ui.card():
        ui.label(name).classes("text-subtitle1")
        box = ui.number(value=value, precision=0 if whole else None).props(
            f'autofocus outlined dense data-testid=number aria-label="{name}"'
        )
        box.on("keydown.enter", lambda: dialog.submit(box.value))
        with ui.row().classes("w-full justify-end"):
            ui.button("Cancel", on_click=lambda: dialog.submit(None)).props("flat")
            ui.button("Set", on_click=lambda: dialog.submit(box.value)).props("data-testid=number-set")
    answer = await dialog
    dialog.delete()
    return None if answer is None else float(answer)
