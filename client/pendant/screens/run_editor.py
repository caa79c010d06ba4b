"""An editor for URScript: what is in it can be sent, and errors are marked on their line."""

import asyncio
from typing import Any, Final

from nicegui import events, ui

from client.pendant.draft import Draft, ScriptError
from client.pendant.page import Page
from client.pendant.situation import Action

__all__ = ["build_editor", "replace_draft"]

_PHASES: Final = {
    "": "",
    "sent": "Sent",
    "running": "Running",
    "ended": "Ended",
    "failed": "Error",
    "silent": "It has not started: the log may say why",
}
_COLORS: Final = {"running": "good", "failed": "bad", "silent": "bad", "": "none"}


def build_editor(page: Page) -> None:
    """Put it on the page."""
    draft = page.station.programs.draft
    author = page.live.page_id
    with ui.row().classes("program-head"):
        ui.button("Send", icon="send", on_click=page.doing(lambda: _send(page))).props(
            "no-caps unelevated data-testid=script-send"
        )
        _opener(page)
        ui.button("Save", icon="save_alt", on_click=lambda: ui.download(draft.text.encode(), "pendant.script")).props(
            "flat no-caps data-testid=script-save"
        )
        ui.space()
        phase = page.live.text(lambda _: _PHASES[draft.phase], "chip").props("data-testid=script-phase")
        page.live.bind(phase, "state", lambda _: _COLORS.get(draft.phase, ""))
    editor = ui.codemirror(draft.text, language="Python", theme="githubLight", indent="  ").classes("script-editor")
    editor.props("data-testid=script-editor")
    editor.on_value_change(lambda change: _write(page, draft, change.value, author))
    page.live.effect(lambda _: (draft.revision, draft.author), lambda _: _show(editor, draft, author))
    page.live.effect(lambda _: draft.error, lambda error: _mark(editor, error))
    with ui.row().classes("script-error") as row:
        ui.icon("error")
        text = page.live.text(lambda _: _error(draft), "script-error-text").props("data-testid=script-error")
        text.on("click", lambda: _mark(editor, draft.error))
    page.live.effect(lambda _: draft.error is not None, row.set_visibility)
    ui.run_javascript(f"pendantRun.editor({editor.id})")


async def replace_draft(page: Page, text: str) -> bool:
    """Put another text into the editor, after asking if somebody's text would be lost; whether that was done."""
    draft = page.station.programs.draft
    if (
        draft.is_somebodys
        and draft.text != text
        and not await page.confirm(
            "Replace the script?",
            "The text in the editor is replaced. Save it first if you want to keep it.",
            "Replace",
        )
    ):
        return False
    draft.write(text)
    return True


async def _send(page: Page) -> None:
    station = page.station
    draft, script = station.programs.draft, station.programs.draft.prepared()
    if script.name:  # it may move the arm, and takes the place of what does
        station.situation.require(Action.SEND)
        if not await page.may_move():
            return
        await station.mover.give_back()
    draft.sending(script, asyncio.get_running_loop().time())
    await station.send_script(script.text)


def _opener(page: Page) -> None:
    """A button that reads a file of the browser's machine."""

    async def take(upload: events.UploadEventArguments) -> None:
        await page.attempt(lambda: _open(page, upload))
        picker.reset()

    picker = ui.upload(on_upload=take, auto_upload=True, max_file_size=2_000_000).classes("hidden")
    picker.on("rejected", lambda: page.complain("a script has at most 2 MB"))
    picker.props('accept=".script,.txt,.py" data-testid=script-file')
    ui.button("Open", icon="folder_open", on_click=lambda: picker.run_method("pickFiles")).props("flat no-caps")


async def _open(page: Page, upload: events.UploadEventArguments) -> None:
    data = await upload.file.read()
    await replace_draft(page, data.decode("utf-8", "replace").removeprefix("\ufeff").replace("\r\n", "\n"))


def _write(page: Page, draft: Draft, text: str, author: str) -> None:
    try:
        draft.write(text, author)
    except ValueError as error:
        page.complain(str(error))


def _show(editor: ui.codemirror, draft: Draft, author: str) -> None:
    """What another browser wrote."""
    if draft.author != author and editor.value != draft.text:
        editor.set_value(draft.text)


def _mark(editor: ui.codemirror, error: ScriptError | None) -> None:
    marks = list[dict[str, Any]]()
    if error is not None:
        lines = (editor.value or "").splitlines(keepends=True)[: error.line]
        end = sum(map(len, lines)) - (len(lines[-1]) - len(lines[-1].rstrip("\r\n")) if lines else 0)
        marks.append({"kind": "line", "line": error.line, "class": "script-bad-line"})
        marks.append(
            {"kind": "widget", "position": end, "text": f"  {' '.join(error.text.split())}", "class": "script-bad-text"}
        )
    editor.decorations = marks
    if error is not None:
        editor.reveal_line(error.line)


def _error(draft: Draft) -> str:
    error = draft.error
    return "" if error is None else f"Line {error.line}, column {error.column}: {error.text}"
