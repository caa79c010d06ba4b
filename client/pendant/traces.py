"""The run of an emulator so far as a page: its journal, of which ``ur-emulator trace`` makes one."""

import asyncio
from base64 import b64decode
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from client.errors import ClientError
from client.pendant import processes
from client.pendant.station import Station
from urproto.compat import module_command
from urproto.durable import write_file

SHOWN_S: Final = 600.0
"""The last part of the run that a page shows."""
_TIMEOUT_S: Final = 120.0  # guess: an hour at rest takes a tenth of this
_TOO_LONG: Final = (
    "the run is too long to be executed again here: ur-emulator ctl journal --file run.journal, then trace"
)


async def page_of_run(station: Station) -> bytes:
    """The page of the run. Raises ClientError, NotPossible if the emulator has no journal, OSError."""
    journal = b64decode(await station.emulator.call("journal"))
    uptime_s = float(station.values.get("timestamp") or 0.0)
    with TemporaryDirectory() as folder:
        file, page = Path(folder, "run.journal"), Path(folder, "run.html")
        await asyncio.to_thread(write_file, file, journal)
        words = ["trace", str(file), "-o", str(page), "--from", str(max(0.0, uptime_s - SHOWN_S))]
        try:
            done = await processes.run([*module_command("emulator"), *words], b"", _TIMEOUT_S)
        except TimeoutError as error:
            raise ClientError(_TOO_LONG) from error
        if not page.exists():
            raise ClientError(done.errors.decode("utf-8", "replace").strip())
        return await asyncio.to_thread(page.read_bytes)
