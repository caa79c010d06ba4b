"""Automatic start: load an installation and a program at boot, release the brakes and start the program by inputs.

This implements the installation's page Default Program (Software Manual of both series). Rules that depend on
PolyScope's screens are left out, because there are none: the Run screen counts as open.
"""

import logging
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Final

from emulator.io.signals import BIT_COUNT
from emulator.lifecycle.power import PowerEvent, PowerState
from emulator.machine import Machine
from emulator.programs.loading import DEFAULT_URPX
from emulator.programs.runner import Programs
from emulator.workshare import in_periods
from urproto.modes import RuntimeState
from urproto.signals import CONFIGURABLE, STANDARD, TOOL
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import DefaultProgram, InputTrigger, read_installation_steps
from urscript.polyscope.writer import find_pin
from urscript.work import Steps, run_to_end

_INSTALLATION: Final = "default"
_GROUPS: Final = {"digital_in": STANDARD, "config_in": CONFIGURABLE, "tool_in": TOOL}

_logger = logging.getLogger(__name__)


class Startup:
    """Boots a machine, then watches the inputs that its installation names.

    A controller that takes time to boot loads in the meantime; one that boots instantly loads in its constructor.
    """

    def __init__(self, machine: Machine, programs: Programs) -> None:
        self._machine, self._programs = machine, programs
        self._release = _Watch(machine)
        self._start = _Watch(machine)
        self._start_allowed = True
        self._settings = DefaultProgram()
        self._path: Path | None = None  # of the default program
        self._boot: Generator[None, None, None] | None = None
        if machine.power.state is PowerState.CONTROLLER_BOOTING:
            self._boot = in_periods(self._boot_steps(), machine.work)
        else:
            run_to_end(self._boot_steps())

    def allow_start(self, allowed: bool) -> None:
        """Allow or forbid inputs to start the program: a stop by a client forbids it, playing allows it again."""
        self._start_allowed = allowed

    def advance(self) -> None:
        """Advance one control period, before programs run."""
        machine = self._machine
        if self._boot is not None:
            self._continue_boot(self._boot)
            return
        wanted = machine.installation.file.default_program
        if wanted is not self._settings:
            self._settings, self._path = wanted, ProgramsFolder(machine.config.programs_dir).find(wanted.name)
        release = wanted.release_brakes
        if self._release.switched(release) and not machine.power.running:
            self._act(release, "release the brakes", lambda: machine.power_event(PowerEvent.BRAKE_RELEASE))
        if wanted.start is not None and not self._start.known and not self._ready():
            return  # the input is first read when the program can be started: then the level alone is sufficient
        if self._start.switched(wanted.start) and self._start_allowed and self._ready():
            self._act(wanted.start, "start the default program", self._programs.play)

    # booting

    def _continue_boot(self, boot: Generator[None, None, None]) -> None:
        try:
            next(boot)
        except StopIteration:
            self._boot = None

    def _boot_steps(self) -> Steps[None]:
        machine = self._machine
        if machine.version.is_polyscope_x:  # its programs contain their installations
            yield from self._programs.load_default_steps(DEFAULT_URPX)
            return
        folder = ProgramsFolder(machine.config.programs_dir)
        installation = folder.installation(_INSTALLATION)
        if installation is None:
            return
        try:
            file = yield from read_installation_steps(installation)
            machine.apply_installation(installation, file)
        except (OSError, ValueError) as error:
            self._report(f"{installation.name} cannot be used: {error}")
            return
        wanted = file.default_program
        if not (wanted.load and wanted.name):
            return
        path = folder.find(wanted.name)
        if path is None:
            self._report(f"the default program {wanted.name} of {installation.name} is not in the programs folder")
            return
        try:
            yield from self._programs.load_default_steps(path)
        except (OSError, ValueError) as error:
            self._report(f"loading the default program {wanted.name} failed: {error}")

    # acting

    def _ready(self) -> bool:
        """Whether the default program is loaded, no program runs, and the arm can move."""
        programs = self._programs
        loaded = programs.loaded is not None and programs.loaded.path == self._path
        return loaded and programs.state is RuntimeState.STOPPED and self._machine.may_play

    def _act(self, trigger: InputTrigger | None, purpose: str, act: Callable[[], object]) -> None:
        if trigger is None or self._machine.local_control:
            return
        self._machine.messages.note(f"{trigger.pin} is {'high' if trigger.level else 'low'}: {purpose}")
        act()

    def _report(self, text: str) -> None:
        self._machine.messages.note(text)
        _logger.warning("%s", text)


class _Watch:
    """Monitors one input. Its level is unknown when the controller starts: the trigger level then counts as reached."""

    def __init__(self, machine: Machine) -> None:
        self.known = False
        self._machine = machine
        self._trigger: InputTrigger | None = None
        self._level: Callable[[], bool] | None = None
        self._before: bool | None = None

    def switched(self, trigger: InputTrigger | None) -> bool:
        """Whether the input has reached its trigger level in this period. A new input starts with its present level."""
        if trigger is not self._trigger:
            self._trigger, self._level = trigger, None if trigger is None else self._reader(trigger)
            self._before = self._level() if self.known and self._level is not None else None
        self.known = True
        if trigger is None or self._level is None:
            return False
        before, self._before = self._before, self._level()
        return self._before is trigger.level and before is not trigger.level

    def _reader(self, trigger: InputTrigger) -> Callable[[], bool] | None:
        machine = self._machine
        kind, number = find_pin(trigger.pin, machine.installation.file.pins) or ("", "")
        index = int(number) if number.isdigit() else -1
        if kind in _GROUPS and index < _GROUPS[kind].count:
            group = _GROUPS[kind]
            return lambda: machine.signals.get_digital_input(group, index)
        if kind == "GP_bool_in" and index < BIT_COUNT:
            return lambda: machine.registers.input.get_bit(index)
        text = f"{machine.installation.name}: {trigger.pin} is not a digital input: it triggers nothing"
        machine.messages.note(text)
        return None
