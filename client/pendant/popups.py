"""The robot's dialogues, on whatever screen one is."""

from typing import Any

from nicegui import ui

from client import dashboard
from client.pendant.dialogues import Dialogue
from client.pendant.page import Page
from client.pendant.station import Station
from urproto.modes import RequestedType

__all__ = ["show_dialogues"]

_ELSEWHERE = "Robots take answers on their own pendant only."


def show_dialogues(page: Page) -> None:
    """Show the oldest open dialogue above everything, the next when that is gone."""
    with ui.dialog().props("persistent") as dialog:
        card = ui.card().classes("dialogue").props("data-testid=dialogue")
    shown: list[Dialogue | None] = [None]

    def show(oldest: Dialogue | None) -> None:
        shown[0] = oldest
        card.clear()
        if oldest is None:
            dialog.close()
            return
        with card:
            _build(page, oldest)
        dialog.open()

    page.live.effect(_oldest, show)


def _oldest(station: Station) -> Dialogue | None:
    return next(iter(station.dialogues.open.values()), None)


def _build(page: Page, dialogue: Dialogue) -> None:
    icon = {"error": "error", "warning": "warning"}.get(dialogue.severity, "info")
    with ui.row().classes("items-center no-wrap"):
        ui.icon(icon).classes(f"dialogue-icon {dialogue.severity}")
        ui.label(dialogue.title).classes("text-h6")
    ui.label(dialogue.text).classes("dialogue-text")
    with ui.row().classes("w-full justify-end items-center"):
        if dialogue.type is RequestedType.NONE:
            ui.button("OK", on_click=page.doing(lambda: _close(page.station, dialogue))).props("data-testid=popup-ok")
        elif page.station.behind.available:
            _answers(page, dialogue)
        else:
            ui.label(_ELSEWHERE)
            ui.button("Hide", on_click=lambda: page.station.dialogues.close(dialogue.number)).props("flat")


def _answers(page: Page, dialogue: Dialogue) -> None:
    def answer(value: Any) -> Any:
        return page.doing(lambda: _answer(page.station, dialogue, value))

    ui.button("Cancel", on_click=answer(None)).props("flat").props("data-testid=answer-cancel")
    if dialogue.type is RequestedType.BOOLEAN:
        ui.button("No", on_click=answer(False)).props("data-testid=answer-no")
        ui.button("Yes", on_click=answer(True)).props("data-testid=answer-yes")
        return
    box = ui.input().props("autofocus outlined dense").props("data-testid=answer")

    async def submit() -> None:
        await page.attempt(lambda: _answer(page.station, dialogue, _value(dialogue.type, box.value or "")))

    box.on("keydown.enter", submit)
    ui.button("OK", on_click=submit).props("data-testid=answer-ok")


def _value(kind: RequestedType, text: str) -> int | float | str:
    """What somebody typed. Raises ValueError."""
    if kind is RequestedType.INTEGER:
        return int(text)
    return float(text) if kind is RequestedType.FLOAT else text


async def _close(station: Station, dialogue: Dialogue) -> None:
    if station.behind.available:
        await station.behind.call("answer_popup", popup_id=dialogue.number)
        station.dialogues.close(dialogue.number)
    else:
        await station.ask(dashboard.CLOSE_POPUP)
        station.dialogues.close_popups()


async def _answer(station: Station, dialogue: Dialogue, value: Any) -> None:
    await station.behind.call("answer_popup", popup_id=dialogue.number, value=value)
    station.dialogues.close(dialogue.number)
