"""Creates a programs folder for a controller without one, once a file has to be saved."""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from emulator.machine import Machine
from emulator.programs.loading import DRIVER_PROGRAMS


def ensure_programs_folder(machine: Machine) -> Path:
    """Return the programs folder. If none was given, create a temporary one, which the system may clear."""
    folder = machine.config.programs_dir
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="ur-emulator-programs-"))
        shutil.copytree(DRIVER_PROGRAMS, folder, dirs_exist_ok=True)  # these are available without a folder, too
        machine.config = replace(machine.config, programs_dir=folder)
        machine.messages.note(f"there is no programs folder: files are saved to {folder}, see --programs")
    return folder
