"""Verbs about the installation file, for the teach pendant's Installation screen."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from emulator.control.verbs import ControlledRobot, Verbs, Waiting, verb
from emulator.controller import Controller
from emulator.programs.loading import ensure_programs_folder
from emulator.services.urcap import DriverAddress
from emulator.workshare import in_periods
from urproto.controlapi import BadArguments, NotPossible
from urproto.durable import writing
from urproto.text import unknown
from urscript.polyscope.document import DocumentError, Element, packed, read_steps, write_document
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import read_installation_document
from urscript.polyscope.installation_sections import Row, SettingError
from urscript.polyscope.installation_settings import (
    SECTIONS,
    add_setting,
    change_setting,
    new_installation,
    read_section,
    remove_setting,
)
from urscript.polyscope.safety_settings import SAFETY_SECTIONS, add_safety

_DEFAULT: Final = "default.installation"
_OF_SAFETY: Final = ("", *(section.name for section in SAFETY_SECTIONS))


class InstallationVerbs(Verbs):
    """Verbs about the installation file."""

    def __init__(self, robot: ControlledRobot) -> None:
        super().__init__(robot)
        self._saving = False

    @verb
    def installation(self, section: str = "") -> dict[str, Any]:
        """The content of the installation file, or one of its sections: lists of rows, in SI units.

        ``file``: its name, also if it does not exist yet. Sections: tcps, payloads, mounting, features,
        io, modbus, external_control, default_program, safety_limits, safety_joints, safety_planes,
        safety_tool_direction, safety_io, safety_home.
        """
        if section and section not in SECTIONS:
            raise BadArguments(unknown("section", section, SECTIONS))
        return self._wait(self._shown(section))

    @verb
    def change_installation(self, section: str, values: Mapping[str, Any], name: str = "") -> None:
        """Change values of a row of the installation file, save the file, and apply the change.

        ``name``: name of the row, if the section is a list. Everything else in the file stays byte for byte. For
        example, {"host": "192.168.56.1"} in section external_control.
        """
        return self._wait(self._saved(section, lambda root: change_setting(root, section, name, values), values))

    @verb
    def add_to_installation(self, section: str, values: Mapping[str, Any]) -> None:
        """Add a row to a list of the installation file: tcps, payloads, features, modbus."""
        return self._wait(self._saved(section, lambda root: add_setting(root, section, values)))

    @verb
    def remove_from_installation(self, section: str, name: str) -> None:
        """Remove a row from a list of the installation file."""
        return self._wait(self._saved(section, lambda root: remove_setting(root, section, name)))

    def _shown(self, section: str) -> Waiting[dict[str, Any]]:
        path = _place(self.controller)
        root = yield from self._document(path, section)
        shown = dict[str, list[Row]]()
        for name in [section] if section else SECTIONS:
            yield  # one section per control period: an installation may have hundreds of features
            shown[name] = read_section(root, name)
        return {"file": _DEFAULT if path is None else path.name, "sections": shown}

    def _saved(
        self, section: str, change: Callable[[Element], None], values: Mapping[str, Any] | None = None
    ) -> Waiting[None]:
        """Read, change, save and apply the file; one change at a time, so that clients do not lose changes."""
        while self._saving:
            yield
        self._saving = True
        try:
            controller = self.controller
            path = _place(controller) or ensure_programs_folder(controller).resolve() / _DEFAULT
            root = yield from self._document(path, section)
            try:
                change(root)
                _check_program(controller, section, root)
                yield  # each of these steps in its own control period: big files take milliseconds
                variables = path.with_suffix(".variables")
                stored_values = variables.read_bytes() if variables.is_file() else b""
                file = read_installation_document(root, path.stem, stored_values)
            except (SettingError, DocumentError) as error:
                raise BadArguments(f"{path.name}: {error}") from error
            yield
            content = write_document(root)
            yield
            yield from _write(path, packed(content))
            controller.use_installation(path, file, section)
            if section == "external_control":  # overrides --external-control until the emulator is restarted
                given = controller.config.external_control
                kept = DriverAddress(
                    None if "host" in (values or ()) else given.host, None if "port" in (values or ()) else given.port
                )
                controller.config = replace(controller.config, external_control=kept)
        finally:
            self._saving = False

    def _document(self, path: Path | None, section: str) -> Waiting[Element]:
        controller = self.controller
        if path is None or not path.is_file():
            root = new_installation(controller.version, "default" if path is None else path.stem)
        else:
            try:
                found = yield from in_periods(read_steps(path.read_bytes()), controller.work)
            except (OSError, DocumentError) as error:
                raise NotPossible(f"{path.name} cannot be read: {error}") from error
            assert found is not None
            root = found
        if section in _OF_SAFETY:
            add_safety(root, controller.safety_board.configuration, controller.model)
        return root


def _place(controller: Controller) -> Path | None:
    """The file in use, otherwise the one that is loaded at boot; None without a programs folder."""
    if controller.installation.path is not None:
        return controller.installation.path
    folder = controller.config.programs_dir
    return None if folder is None else folder.resolve() / _DEFAULT


def _check_program(controller: Controller, section: str, root: Element) -> None:
    """Check that the program to be loaded at boot exists. Raises SettingError."""
    if section != "default_program":
        return
    row = SECTIONS[section].rows(root)[0]
    if row["file"] and ProgramsFolder(controller.config.programs_dir).find(row["file"]) is None:
        raise SettingError(f"there is no program {row['file']} in the programs folder")


def _write(path: Path, content: bytes) -> Waiting[None]:
    """Replace the file, completely or not at all."""
    try:
        yield from writing(path, content)
    except OSError as error:
        raise NotPossible(f"{path.name} cannot be saved: {error.strerror or error}") from error
