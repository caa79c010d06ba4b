"""Runs as pages, which ``ur-emulator trace`` makes: of the emulator so far, and of files that users open."""

import asyncio
import os
import re
import secrets
from base64 import b64decode
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from client.errors import ClientError
from client.pendant import processes
from client.pendant.station import Station
from urproto.compat import module_command
from urproto.durable import write_file

ROUTE: Final = "/traces"
"""Path of the pages of opened files on a pendant: /traces/TOKEN."""
POLICY: Final = "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'"
"""What these pages may do in a browser: nothing with the pendant, although they come from its address."""
OPENED: Final = (".journal", ".mcap", ".csv", ".npz", ".html")
"""Files that can be opened: journals, recordings, and pages of them."""
_KEPT: Final = 4  # pages of opened files (guess)
SHOWN_S: Final = 600.0
"""The last part of the run that a page shows."""
_LONGEST_NAME: Final = 80
_TIMEOUT_S: Final = 120.0  # guess: an hour at rest takes a tenth of this
_TOO_LONG: Final = (
    "the run is too long to be executed again here: ur-emulator ctl journal --file run.journal, then trace"
)


async def page_of_run(station: Station) -> bytes:
    """The page of the run. Raises ClientError, NotPossible if the emulator has no journal, OSError."""
    journal = b64decode(await station.emulator.call("journal"))
    uptime_s = float(station.values.get("timestamp") or 0.0)
    return await _page_of("run.journal", journal, "--from", str(max(0.0, uptime_s - SHOWN_S)))


class OpenedFiles:
    """The pages of the files that users have opened last."""

    def __init__(self) -> None:
        self._pages: dict[str, bytes] = {}

    async def open(self, content: bytes, name: str) -> str:
        """Make the page of a file; returns its path on the pendant. Raises ClientError, OSError."""
        if not name.lower().endswith(OPENED):
            raise ClientError(f"choose a file of the kinds {', '.join(OPENED)}")
        page = await _page_of(re.sub(r"[^\w.-]+", "_", name)[-_LONGEST_NAME:].lower(), content)
        token = secrets.token_urlsafe()
        self._pages[token] = page
        for old in list(self._pages)[:-_KEPT]:
            del self._pages[old]
        return f"{ROUTE}/{token}"

    def page(self, token: str) -> bytes | None:
        """A page, if it is still kept."""
        return self._pages.get(token)


opened_files: Final = OpenedFiles()
"""Of this process, which serves one pendant."""


async def _page_of(name: str, content: bytes, *options: str) -> bytes:
    with TemporaryDirectory() as folder:
        file, page = Path(folder, name), Path(folder, "page")
        await asyncio.to_thread(write_file, file, content)
        words = ["trace", str(file), "-o", str(page), *options]
        try:
            done = await processes.run([*module_command("emulator"), *words], b"", _TIMEOUT_S)
        except TimeoutError as error:
            raise ClientError(_TOO_LONG) from error
        if not page.exists():
            raise ClientError(done.errors.decode("utf-8", "replace").strip().replace(f"{folder}{os.sep}", ""))
        return await asyncio.to_thread(page.read_bytes)
