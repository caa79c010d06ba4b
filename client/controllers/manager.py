"""The controller manager: loads controllers, lends them interfaces, and calls them once per cycle."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Any, Final

from client.controllers import configuration
from client.controllers.configuration import ControllersFile
from client.controllers.controller import LIFE_CYCLE, Controller, Hardware, Interfaces, LifecycleState
from client.controllers.modes import MOTION, CommandMode, mode_of
from client.controllers.parameters import Reading, read_parameters
from client.driver.endpoint import notify
from client.errors import ControllerError, StateError

_logger = logging.getLogger(__name__)

_COMMAND: Final = "command"
_STATE: Final = "state"


@dataclass(frozen=True, slots=True)
class ControllerInfo:
    """A loaded controller; claimed: the command interfaces that it has claimed."""

    name: str
    type: str
    state: LifecycleState
    claimed: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class InterfaceInfo:
    """A command interface and the controller that has claimed it, "" for none; or a state interface."""

    name: str
    kind: str
    claimed_by: str


class ControllerManager:
    """The controllers of one robot; `cycle` is called with each of its states, everything else between cycles.

    file: types and parameters of controllers by name. notes: parameters of loaded controllers that are unknown or have
    no effect. on_load: called with each controller that is loaded. on_stop: called with the names of controllers that
    are deactivated because the arm cannot move. on_cycle: called after each cycle.
    """

    def __init__(self, hardware: Hardware, file: ControllersFile, update_rate_hz: float, prefix: str = "") -> None:
        self.hardware = hardware
        self.file = file
        self.update_rate_hz = update_rate_hz
        self.notes: list[str] = []
        self.on_load: list[Callable[[Controller[Any]], object]] = []
        self.on_stop: list[Callable[[list[str]], object]] = []
        self.on_cycle: list[Callable[[], object]] = []
        self.time_s = 0.0
        self._unusable = False  # the state before this one
        self._prefix = prefix
        self._controllers: dict[str, Controller[Any]] = {}

    # the life cycle

    def load(self, name: str, type_name: str | None = None, parameters: Mapping[str, Any] | None = None) -> Any:
        """Load a controller, as described in the file or by the arguments. Raises ControllerError."""
        if name in self._controllers:
            raise ControllerError(name, "it is already loaded")
        kind = configuration.find(name, type_name or self.file.type_of(name))
        given = self.file.parameters_of(name) if parameters is None else parameters
        reading = Reading()
        read = read_parameters(kind.parameters_type, given, name, reading)
        self._add_notes(name, reading)
        controller = kind(name, read, self.update_rate_hz)
        self._controllers[name] = controller
        notify(self.on_load, controller)
        return controller

    def _add_notes(self, name: str, reading: Reading) -> None:
        notes = [f"{name}: the parameter {key} is unknown and ignored" for key in reading.unknown]
        for note in notes:
            _logger.warning("%s", note)
        self.notes += notes
        self.notes += [f"{name}: the parameter {key} has no effect" for key in reading.without_effect]

    def configure(self, name: str) -> None:
        """Configure a controller, which checks its parameters. Raises ControllerError."""
        controller = self.controller(name)
        state = _next(controller, "configure")
        controller.on_configure()
        controller.state = state

    def cleanup(self, name: str) -> None:
        """Return a controller to the state unconfigured. Raises ControllerError."""
        controller = self.controller(name)
        controller.state = _next(controller, "cleanup")

    def unload(self, name: str) -> None:
        """Unload a controller. Raises ControllerError while it is active."""
        controller = self.controller(name)
        controller.state = _next(controller, "shutdown")
        del self._controllers[name]

    def activate(self, *names: str) -> None:
        """Load and configure controllers if necessary, and activate all of them together. Raises ControllerError."""
        for name in names:
            if name not in self._controllers:
                self.load(name)
            if self.controller(name).state is LifecycleState.UNCONFIGURED:
                self.configure(name)
        self.switch(activate=names)

    def deactivate(self, *names: str) -> None:
        """Deactivate controllers. Raises ControllerError."""
        self.switch(deactivate=names)

    def switch(
        self, *, activate: Sequence[str] = (), deactivate: Sequence[str] = (), best_effort: bool = False
    ) -> None:
        """Deactivate some controllers and activate others in one cycle; on an error, nothing changes.

        One exception: if a controller fails during its activation, the others have already been deactivated; then none
        is activated. best_effort: leave out controllers that are not in a suitable state, instead of raising. Raises
        ControllerError, which names the interface that two controllers would claim.
        """
        ending, beginning = list(dict.fromkeys(deactivate)), list(dict.fromkeys(activate))
        if best_effort:
            ending = [name for name in ending if self._has_state(name, LifecycleState.ACTIVE)]
            beginning = [name for name in beginning if self._has_state(name, LifecycleState.INACTIVE) or name in ending]
        for name in ending:
            _next(self.controller(name), "deactivate")
        for name in beginning:
            if name not in ending:
                _next(self.controller(name), "activate")
        self._check_claims(beginning, ending)
        start, stop = self._claims(beginning), self._claims(ending)
        self.hardware.prepare_command_mode_switch(start, stop)
        for name in ending:
            self._end(self.controller(name))
        self.hardware.perform_command_mode_switch(start, stop)
        self._begin(beginning)

    def _has_state(self, name: str, state: LifecycleState) -> bool:
        return name in self._controllers and self._controllers[name].state is state

    def _check_claims(self, beginning: Iterable[str], ending: Sequence[str]) -> None:
        holders = {
            interface: controller.name
            for controller in self.active()
            if controller.name not in ending
            for interface in controller.command_interfaces
        }
        for name in beginning:
            controller = self.controller(name)
            for interface in controller.command_interfaces:
                if interface not in self.hardware.commands:
                    raise ControllerError(name, f"the hardware has no command interface {interface}")
                if holder := holders.get(interface):
                    raise ControllerError(name, f"{holder} has claimed {interface}: deactivate it in the same switch")
                holders[interface] = name
            self._states_of(controller)

    def _claims(self, names: Iterable[str]) -> list[str]:
        return [interface for name in names for interface in self.controller(name).command_interfaces]

    def state_interfaces_of(self, controller: Controller[Any]) -> list[str]:
        """Names of the state interfaces that a controller reads, with patterns expanded to the hardware's names."""
        known = self.hardware.states.names
        names: list[str] = []
        for wanted in controller.state_interfaces:
            names += [name for name in known if fnmatchcase(name, wanted)] if "*" in wanted else [wanted]
        return names

    def _states_of(self, controller: Controller[Any]) -> Interfaces:
        names = self.state_interfaces_of(controller)
        if missing := [name for name in names if name not in self.hardware.states]:
            raise ControllerError(controller.name, f"the hardware has no state interface {missing[0]}")
        return self.hardware.states.lend(names)

    def _begin(self, names: Sequence[str]) -> None:
        begun: list[Controller[Any]] = []
        for name in names:
            controller = self.controller(name)
            controller.states = self._states_of(controller)
            controller.commands = self.hardware.commands.lend(controller.command_interfaces)
            try:
                controller.on_activate(self.time_s)
            except ControllerError:
                for other in begun:
                    self._end(other)
                self.hardware.perform_command_mode_switch([], self._claims(names))
                raise
            controller.state = LifecycleState.ACTIVE
            begun.append(controller)

    def _end(self, controller: Controller[Any]) -> None:
        controller.on_deactivate()
        controller.state = LifecycleState.INACTIVE

    # queries

    def controller(self, name: str) -> Any:
        """A loaded controller. Raises ControllerError."""
        try:
            return self._controllers[name]
        except KeyError:
            loaded = ", ".join(self._controllers) or "none"
            raise ControllerError(name, f"it is not loaded (loaded: {loaded}): load it first") from None

    def active(self) -> list[Controller[Any]]:
        """Controllers that are updated, in the order in which they were loaded."""
        return [controller for controller in self._controllers.values() if controller.active]

    def moving(self) -> list[Controller[Any]]:
        """Active controllers that move the arm."""
        return [controller for controller in self.active() if self._modes_of(controller) & MOTION]

    def modifying(self) -> list[Controller[Any]]:
        """Active controllers that change how the arm moves: force mode, tool contact."""
        return [controller for controller in self.active() if self._modes_of(controller) - MOTION]

    def _modes_of(self, controller: Controller[Any]) -> set[CommandMode]:
        modes = (mode_of(name, self._prefix) for name in controller.command_interfaces)
        return {mode for mode in modes if mode is not None}

    def list_controllers(self) -> list[ControllerInfo]:
        return [
            ControllerInfo(one.name, one.type_name, one.state, one.command_interfaces if one.active else ())
            for one in self._controllers.values()
        ]

    def list_interfaces(self) -> list[InterfaceInfo]:
        holders = {name: one.name for one in self.active() for name in one.command_interfaces}
        return [
            *(InterfaceInfo(name, _COMMAND, holders.get(name, "")) for name in self.hardware.commands.names),
            *(InterfaceInfo(name, _STATE, "") for name in self.hardware.states.names),
        ]

    # a cycle

    def cycle(self, state: Mapping[str, Any], time_s: float, period_s: float) -> bool:
        """Read a state of the robot, update the active controllers, write their commands.

        time_s: the robot's time. period_s: time since the last cycle. Returns False for an invalid state, which
        deactivates the controllers that move the arm, and no others.
        """
        try:
            self.hardware.read(state, period_s)
        except StateError as error:
            if not self._unusable:
                _logger.warning("%s", error)
            self._unusable = True
            self.stop_motion(str(error))
            return False
        self._unusable = False
        self.time_s = time_s
        if self.hardware.failure is not None:
            self.stop_motion(self.hardware.failure)
        if (halt := self.hardware.take_halt()) is not None:
            for controller in self.moving():
                controller.on_halt(halt)
        for controller in self.active():
            try:
                controller.update(time_s, period_s)
            except Exception:  # one that fails must not stop the others
                _logger.exception("%s failed and is deactivated", controller.name)
                self._deactivate_failed([controller])
        self.hardware.write(time_s, period_s)
        for after in self.on_cycle:
            after()
        return True

    def stop_motion(self, reason: str) -> None:
        """Deactivate the controllers that move the arm, and end their goals, because the arm cannot move."""
        if moving := self.moving():
            _logger.error("controllers are deactivated: %s", reason)
            for controller in moving:
                controller.on_halt(reason)
            self._deactivate_failed(moving)
            notify(self.on_stop, [controller.name for controller in moving])

    def fall_silent(self, reason: str) -> None:
        """Take note that no states come until the next cycle; controllers that do not move the arm stay active."""
        self.stop_motion(reason)
        for controller in self.active():
            controller.on_silence(reason)

    def _deactivate_failed(self, controllers: Iterable[Controller[Any]]) -> None:
        for controller in controllers:
            try:
                controller.on_deactivate()
            except Exception:
                _logger.exception("%s failed while it was deactivated", controller.name)
            controller.state = LifecycleState.INACTIVE
            self.hardware.perform_command_mode_switch([], controller.command_interfaces)


def _next(controller: Controller[Any], transition: str) -> LifecycleState:
    """The state that a transition leads to. Raises ControllerError for an invalid one."""
    try:
        return LIFE_CYCLE[controller.state, transition]
    except KeyError:
        raise controller.error(f"it is {controller.state}, which cannot be followed by {transition}") from None
