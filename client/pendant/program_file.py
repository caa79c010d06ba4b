"""The file on this machine that keeps the edited program, independent of pendant, browsers and emulator."""

import base64
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from client.errors import FileError
from client.pendant.saved import write_json
from urproto.text import json_document

_INVALID_CHARACTERS: Final = re.compile(r"[^A-Za-z0-9.-]")  # in names of files


@dataclass(frozen=True, slots=True)
class SavedDraft:
    """A saved draft. data: the bytes of its ``.urp`` file in the present state.

    path: in the robot's programs folder, "" if it was never saved there. changed: since it was saved there.
    """

    path: str
    changed: bool
    data: bytes


class ProgramFile:
    """Files in a folder, one for each robot address; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, address: str) -> None:
        self.path = None if folder is None else folder / f"{_INVALID_CHARACTERS.sub('_', address)}.json"

    def read(self) -> SavedDraft | None:
        """The saved draft, None without one. Raises FileError for an unusable file, which is moved aside."""
        path = self.path
        if path is None:
            return None
        try:
            content = json_document(path.read_text("utf-8"))
            draft = SavedDraft(
                str(content["path"]), bool(content["changed"]), base64.b64decode(content["urp"], None, True)
            )
        except FileNotFoundError:
            return None
        except OSError as error:
            raise FileError(path, error.strerror or str(error)) from error
        except (ValueError, TypeError, KeyError, RecursionError) as error:
            raise FileError(path, f"not a program draft of a pendant: {error}; {self.move_aside()}") from error
        return draft

    def move_aside(self) -> str:
        """Rename an unusable file, so that it is not overwritten; returns a text that says where it is."""
        if self.path is None:
            return "nothing is saved"
        new_path = self.path.with_suffix(".unreadable")
        try:
            os.replace(self.path, new_path)
        except OSError as error:
            return f"it could not be renamed: {error.strerror or error}"
        return f"it was renamed to {new_path}"

    def write(self, draft: SavedDraft) -> None:
        """Replace the saved draft, completely or not at all. Raises FileError."""
        if self.path is not None:
            urp = base64.b64encode(draft.data).decode()
            write_json(self.path, {"path": draft.path, "changed": draft.changed, "urp": urp})
