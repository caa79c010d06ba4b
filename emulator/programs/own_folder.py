"""A programs folder for a controller that was given none, once something is to be saved."""

import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from emulator.machine import Machine
from emulator.programs.loading import DRIVER_PROGRAMS


def have_programs_folder(machine: Machine) -> Path:
    """The programs folder; one that the system may clear, where none was given: what is made here can be used."""
    folder = machine.config.programs_dir
    if folder is None:
        folder = Path(tempfile.mkdtemp(prefix="ur-emulator-programs-"))
        shutil.copytree(DRIVER_PROGRAMS, folder, dirs_exist_ok=True)  # what was there without one stays there
        machine.config = replace(machine.config, programs_dir=folder)
        machine.messages.note(f"there is no programs folder: files are saved to {folder}; see --programs")
    return folder
