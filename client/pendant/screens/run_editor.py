"""An editor for URScript: its text can be sent to the robot, and errors are marked at their line."""

import asyncio
from collections.abc import Sequence
from itertools import groupby
from typing import Any, Final

from nicegui import ui

from client.pendant.draft import Draft, ScriptError
from client.pendant.page import Page
from client.pendant.situation import Action
from urproto.text import from_bytes, readable, to_bytes

_PHASES: Final = {
    "": "",
    "sent": "Sent",
    "running": "Running",
    "ended": "Ended",
    "failed": "Error",
    "silent": "It has not started: the log may say why",
}
_COLORS: Final = {"running": "good", "failed": "bad", "silent": "bad", "": "none"}
_MAX_SHOWN: Final = 50


def build_editor(page: Page) -> None:
    draft = page.station.programs.draft
    author = page.live.page_id
    with ui.row().classes("program-head"):
        page.needs_robot(ui.button("Send", icon="send", on_click=page.handler(lambda: _send(page)))).props(
            "no-caps unelevated data-testid=script-send"
        )
        _open_button(page)
        ui.button("Save", icon="save_alt", on_click=lambda: ui.download(to_bytes(draft.text), "pendant.script")).props(
            "flat no-caps data-testid=script-save"
        )
        ui.space()
        phase = page.live.text(lambda _: _PHASES[draft.phase], "chip").props("data-testid=script-phase")
        page.live.bind(phase, "state", lambda _: _COLORS.get(draft.phase, ""))
    editor = ui.codemirror(draft.text, language="Python", theme="githubLight", indent="  ").classes("script-editor")
    ui.run_javascript(f"pendantRun.name({editor.id}, 'Script')")
    editor.props("data-testid=script-editor")
    editor.on_value_change(lambda change: _write(page, draft, change.value, author))
    page.live.effect(lambda _: (draft.revision, draft.author), lambda _: _show(editor, draft, author))
    rows = ui.element("div").classes("script-errors").props("data-testid=script-error")

    def show(problems: tuple[ScriptError, ...]) -> None:
        rows.clear()
        rows.set_visibility(bool(problems))
        _mark_problems(editor, problems)
        with rows:
            for problem in problems[:_MAX_SHOWN]:
                _problem_row(editor, problem)
            if len(problems) > _MAX_SHOWN:
                ui.label(f"and {len(problems) - _MAX_SHOWN} more").classes("soft")

    page.live.effect(lambda _: draft.problems, show)
    page.live.effect(lambda _: draft.error, lambda error: None if error is None else editor.reveal_line(error.line))
    ui.run_javascript(f"pendantRun.editor({editor.id})")


async def replace_draft(page: Page, text: str) -> bool:
    """Replace the text of the editor, after asking if a user's text would be lost; returns whether that was done."""
    draft = page.station.programs.draft
    if (
        draft.has_user_text
        and draft.text != text
        and not await page.confirm(
            "Replace the script?",
            "The text in the editor will be replaced. Save it first if you want to keep it.",
            "Replace",
        )
    ):
        return False
    draft.write(text)
    return True


async def _send(page: Page) -> None:
    station = page.station
    draft, script = station.programs.draft, station.programs.draft.prepared_script()
    if script.name:  # it may move the arm, and replaces the running program
        station.situation.require(Action.SEND)
        if not await page.confirm_move():
            return
        await station.mover.release_control()
    draft.mark_sent(script, asyncio.get_running_loop().time())
    await station.send_script(script.text)


def _open_button(page: Page) -> None:
    async def open_script(data: bytes, _: str) -> None:
        await replace_draft(page, readable(from_bytes(data)).removeprefix("\ufeff").replace("\r\n", "\n"))

    pick = page.picker(".script,.txt,.py", "script-file", open_script, "a script")
    ui.button("Open", icon="folder_open", on_click=pick).props("flat no-caps")


def _write(page: Page, draft: Draft, text: str, author: str) -> None:
    try:
        draft.write(text, author)
    except ValueError as error:
        page.show_error(str(error))


def _show(editor: ui.codemirror, draft: Draft, author: str) -> None:
    """Show changes by other browsers."""
    if draft.author != author and editor.value != draft.text:
        editor.set_value(draft.text)


def _mark_problems(editor: ui.codemirror, problems: Sequence[ScriptError]) -> None:
    lines = (editor.value or "").splitlines(keepends=True)
    marks = list[dict[str, Any]]()
    positions = sorted((min(problem.line, max(1, len(lines))), problem.severity, problem.text) for problem in problems)
    for line, group in groupby(positions, lambda entry: entry[0]):
        _, severity, text = next(group)  # an error, if there is one: it sorts first
        preceding = lines[:line]
        end = sum(map(len, preceding)) - (len(preceding[-1]) - len(preceding[-1].rstrip("\r\n")) if preceding else 0)
        text = f"  {' '.join(text.split())}"
        marks.append({"kind": "line", "line": line, "class": f"script-bad-line {severity}"})
        marks.append({"kind": "widget", "position": end, "text": text, "class": f"script-bad-text {severity}"})
    editor.decorations = marks


def _problem_row(editor: ui.codemirror, problem: ScriptError) -> None:
    with ui.element("button").classes(f"script-error {problem.severity}").props("type=button") as row:
        ui.icon(problem.severity)
        ui.label(f"Line {problem.line}, column {problem.column}: {problem.text}")
    row.on("click", lambda: editor.reveal_line(problem.line))
