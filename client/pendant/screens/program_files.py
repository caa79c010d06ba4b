"""New, open, save and download for the edited program."""

from collections.abc import Callable
from pathlib import PurePosixPath

from nicegui import ui

from client.pendant import program_playback as playback
from client.pendant.page import Page


class FileButtons:
    """The first buttons of the toolbar. why_not_saved: hint of the Save button if there is no folder to save to."""

    def __init__(self, page: Page, button: Callable[..., ui.button]) -> None:
        self._page = page
        self._draft = page.station.program_draft
        button("New", "note_add", page.handler(self.new), "program-new")
        button("Open", "folder_open", page.handler(self.open), "program-open")
        save = button("Save", "save", page.handler(self.save), "program-save")
        save_as = button("Save as", "save_as", page.handler(self.save_as), "program-save-as")
        for save_button in (save, save_as):
            page.live.effect(playback.can_save_files, save_button.set_enabled)
            page.live.bind(
                save_button,
                "title",
                lambda s: (
                    "" if playback.can_save_files(s) else "A robot saves no files for others: download the program"
                ),
            )
        button("Download", "download", page.handler(self.download), "program-download")
        self._pick = page.picker(".urp", "program-file", self._open_uploaded, "a program")

    async def _confirm_replacing(self) -> bool:
        """Whether the program may be replaced; the user is asked if changes would be lost."""
        draft = self._draft
        if not draft.changed:
            return True
        text = f"The changes to {draft.title} are not saved, and everybody here sees this program."
        return await self._page.confirm("Leave this program?", text, "Leave it")

    async def new(self) -> None:
        """Start an empty program."""
        if await self._confirm_replacing():
            self._draft.new()

    async def open(self) -> None:
        """Open a file of the programs folder, or of the browser's machine."""
        page = self._page
        if not await self._confirm_replacing():
            return
        if not playback.can_save_files(page.station):
            self._pick()
            return
        names = [name for name in await page.station.programs.files(page.station) if name.endswith(playback.EXTENSION)]
        choice = await page.choose(
            "Open a program", names, "The programs folder has no .urp files.", "program-choice", "From this machine"
        )
        if choice:
            await playback.open_file(page.station, choice)
        elif choice == "":
            self._pick()

    def _open_uploaded(self, data: bytes, name: str) -> None:
        self._draft.open(data, PurePosixPath(name).name)

    async def save(self) -> None:
        """Save under the present name, or under one that the user enters."""
        if not self._draft.path:
            await self.save_as()
            return
        await playback.save(self._page.station, self._draft.path)
        self._page.show_message(f"{self._draft.path} is saved")

    async def save_as(self) -> bool:
        """Save under another name; returns whether that was done."""
        page, draft = self._page, self._draft

        def field() -> ui.input:
            box = ui.input("Name", value=draft.path or "").props("autofocus outlined dense data-testid=program-name")
            return box.props('suffix=".urp"' if not draft.path else "")

        name = await page.request_value("Save the program as", field, "Save", "program-save-confirm")
        if name is None:
            return False
        path = playback.with_extension(name)
        if path != draft.path and path in await page.station.programs.files(page.station):
            text = f"{path} is there already."
            if not await page.confirm("Replace the program?", text, "Replace it"):
                return False
        await playback.save(page.station, path)
        page.show_message(f"{path} is saved")
        return True

    async def download(self) -> None:
        """Download the program to the browser's machine."""
        name = PurePosixPath(self._draft.path or "unnamed.urp").name
        ui.download(self._draft.data(), name)
