"""Shows the robot's dialogues and protective stops on every screen."""

from math import ceil
from typing import Any, Final

from nicegui import ui

from client import dashboard
from client.pendant.dialogues import ANSWERABLE, Dialogue, parse_answer
from client.pendant.events import report_text
from client.pendant.page import Page
from client.pendant.situation import Action
from client.pendant.station import Station
from urproto.modes import RequestedType

_NOT_ANSWERABLE: Final = "This question can be answered on the robot's own pendant only."
_ICONS: Final = {"error": "error", "warning": "warning"}


def show_dialogues(page: Page) -> None:
    """Show the oldest open dialogue on top of everything, then the next, and a protective stop on top of it."""
    with ui.dialog().props("persistent") as dialog:
        card = ui.card().classes("dialogue").props("data-testid=dialogue")

    def show(shown: tuple[Dialogue | None, bool]) -> None:
        dialogue, answerable = shown
        card.clear()
        if dialogue is None:
            dialog.close()
            return
        with card:
            _build_dialogue(page, dialogue, answerable)
        dialog.open()

    page.live.effect(lambda station: (station.dialogues.oldest, station.emulator.available), show)
    _protective_stop_dialogue(page)


def _header(severity: str, title: str) -> None:
    with ui.row().classes("items-center no-wrap"):
        ui.icon(_ICONS.get(severity, "info")).classes(f"dialogue-icon {severity}")
        ui.label(title).classes("text-h6")


# popups and questions


def _build_dialogue(page: Page, dialogue: Dialogue, emulated: bool) -> None:
    _header(dialogue.severity, dialogue.title)
    ui.label(dialogue.text).classes("dialogue-text").props("data-testid=dialogue-text")
    if dialogue.type is RequestedType.NONE:
        with _buttons():
            ok = ui.button("OK", on_click=page.handler(lambda: _close(page.station, dialogue)))
            ok.props("data-testid=popup-ok autofocus")
    elif emulated and dialogue.type in ANSWERABLE:
        _answers(page, dialogue)
    else:
        ui.label(_NOT_ANSWERABLE)
        with _buttons():
            hide_button = ui.button("Hide", on_click=lambda: page.station.dialogues.close(dialogue.number))
            hide_button.props("flat data-testid=answer-hide")


def _buttons() -> ui.row:
    return ui.row().classes("dialogue-buttons")


def _answers(page: Page, dialogue: Dialogue) -> None:
    if dialogue.type is RequestedType.BOOLEAN:
        with _buttons():
            _answer_button(page, dialogue, "Cancel", None, "answer-cancel").props("flat")
            _answer_button(page, dialogue, "No", False, "answer-no")
            _answer_button(page, dialogue, "Yes", True, "answer-yes")
        return
    box = ui.input().props("autofocus outlined dense data-testid=answer aria-label=Answer").classes("w-full")
    if dialogue.type is not RequestedType.STRING:
        box.props(f"inputmode={'numeric' if dialogue.type is RequestedType.INTEGER else 'decimal'}")

    async def submit() -> None:
        try:
            value = parse_answer(dialogue.type, box.value or "")
        except ValueError as error:
            box.error = str(error)
            return
        await page.attempt(lambda: _answer(page.station, dialogue, value))

    box.on("keydown.enter", submit)
    with _buttons():
        _answer_button(page, dialogue, "Cancel", None, "answer-cancel").props("flat")
        ui.button("OK", on_click=submit).props("data-testid=answer-ok")


def _answer_button(page: Page, dialogue: Dialogue, text: str, value: bool | None, test_id: str) -> ui.button:
    click = page.handler(lambda: _answer(page.station, dialogue, value))
    return ui.button(text, on_click=click).props(f"data-testid={test_id}")


async def _close(station: Station, dialogue: Dialogue) -> None:
    if station.emulator.available:
        await station.emulator.call("answer_popup", popup_id=dialogue.number)
        station.dialogues.close(dialogue.number)
    else:
        await station.request(dashboard.CLOSE_POPUP)
        station.dialogues.close_popups()


async def _answer(station: Station, dialogue: Dialogue, value: Any) -> None:
    await station.emulator.call("answer_popup", popup_id=dialogue.number, value=value)
    station.dialogues.close(dialogue.number)


# the protective stop


def _protective_stop_dialogue(page: Page) -> None:
    station = page.station
    with ui.dialog().props("persistent") as dialog, ui.card().classes("dialogue").props("data-testid=stop-dialogue"):
        _header("error", "Protective stop")
        cause = ui.label().classes("dialogue-text").props("data-testid=stop-cause")
        advice = ui.label().classes("dialogue-advice")
        with _buttons():
            ui.button("Not now", on_click=station.stops.hide).props("flat data-testid=stop-hide")
            unlock = ui.button(on_click=page.handler(lambda: station.request(dashboard.UNLOCK_PROTECTIVE_STOP)))
            unlock.props("data-testid=stop-enable")

    def count_down(seconds: int) -> None:
        unlock.set_text(f"Unlock in {seconds} s" if seconds else "Unlock protective stop")

    page.live.effect(lambda s: s.stops.shown is not None, dialog.set_value)
    page.live.effect(_cause, cause.set_text)
    page.live.effect(lambda s: s.situation.advice, advice.set_text)
    page.live.effect(lambda s: s.situation.permits(Action.UNLOCK), unlock.set_enabled)
    page.live.effect(lambda s: ceil(s.stops.unlock_in_s), count_down)


def _cause(station: Station) -> str:
    stop = station.stops.current
    if stop is None or stop.cause is None:
        return "The robot has not said why."
    return f"{stop.cause.label}: {report_text(stop.cause)}"
