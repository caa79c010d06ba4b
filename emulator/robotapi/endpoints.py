"""The requests of the Robot API: one decorated function each.

``urproto.robotapi.ENDPOINTS`` lists the requests, with the version that introduced each, and whether it needs remote
control. The functions here implement them; their docstrings are the descriptions in the OpenAPI document. A function
takes the controller, and the parts of the request that its annotations name: the body, a program's name in the path, an
uploaded file. It returns the answer, or yields once per control period until the answer is known. It refuses a request
by raising `HttpError`.

Statuses 400, 403, 404, 409, 422, 500 and 504 are from the API's own documentation, as quoted by users. It is a guess
that a program that cannot be played gives 409, and one that cannot be loaded 404: the documentation has 500 for both,
which here means a fault of the emulator.
"""

import inspect
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Final, get_type_hints

import msgspec

from emulator.commands import dashboard
from emulator.controller import Controller
from emulator.lifecycle.power import PowerEvent, PowerState
from emulator.lifecycle.safety import SafetyEvent
from emulator.robotapi.messages import (
    ControlModeAnswer,
    Done,
    LoadedProgram,
    LoadedProgramAnswer,
    LoadProgram,
    OperationalModeAnswer,
    Program,
    Programs,
    ProgramStateAnswer,
    ProgramStateChange,
    RobotModeAnswer,
    SafetyModeAnswer,
    StateChange,
    StoredProgram,
)
from emulator.robotapi.stored import find_program, store_program, stored_programs
from emulator.servers.http import CONFLICT, INVALID, TIMED_OUT, HttpError
from urproto import dashboard as replies
from urproto import robotapi
from urproto.modes import RuntimeState, SafetyMode
from urproto.robotapi import Endpoint, ProgramAction, StateAction, robot_word, safety_word
from urscript.polyscope.folder import read_file

_OK: Final = "OK"
_SWITCHING_S: Final = 60.0  # guess: switching on takes up to half a minute on an arm
_Waiting = Generator[None, None, Any]

_ACTIONS: Final[dict[ProgramAction, tuple[Callable[[Controller], Any], str]]] = {
    ProgramAction.PLAY: (dashboard.play, replies.STARTING),
    ProgramAction.RESUME: (dashboard.play, replies.STARTING),
    ProgramAction.PAUSE: (dashboard.pause, replies.PAUSING),
    ProgramAction.STOP: (dashboard.stop, replies.STOPPED),
}


class Upload(bytes):
    """The file of a multipart request."""


@dataclass(frozen=True, slots=True)
class Operation:
    """A request and the function that implements it. body: type of its JSON; upload, named: whether it takes these."""

    endpoint: Endpoint
    function: Callable[..., Any]
    body: type[msgspec.Struct] | None
    upload: bool
    named: bool
    answer: Any

    @property
    def help(self) -> str:
        return inspect.getdoc(self.function) or ""


OPERATIONS: Final[list[Operation]] = []


def endpoint(place: Endpoint) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Register the function for a request."""

    def register(function: Callable[..., Any]) -> Callable[..., Any]:
        hints = get_type_hints(function)
        answer = hints.pop("return")
        taken = [hints[name] for name in list(inspect.signature(function).parameters)[1:]]
        body = next((kind for kind in taken if isinstance(kind, type) and issubclass(kind, msgspec.Struct)), None)
        result = answer.__args__[2] if hasattr(answer, "__args__") else answer  # of a generator: its return type
        OPERATIONS.append(Operation(place, function, body, Upload in taken, str in taken, result))
        return function

    return register


# the arm


@endpoint(robotapi.PUT_STATE)
def put_state(controller: Controller, change: StateChange) -> Generator[None, None, Done]:
    """Switch the arm on or off, release the brakes, unlock a protective stop, or restart the safety system.

    The answer comes when it is done; immediately if the arm is in the requested state already.
    """
    yield from _CHANGES[change.action](controller)
    return Done(_OK)


def _power_on(controller: Controller) -> _Waiting:
    if not controller.power.report.powered and not controller.power_event(PowerEvent.POWER_ON):
        raise HttpError(CONFLICT, f"the arm cannot be switched on: its safety mode is {controller.safety.mode.name}")
    yield from _reached(controller, PowerState.IDLE, PowerState.RELEASING, PowerState.RUNNING)


def _brake_release(controller: Controller) -> _Waiting:
    if not controller.power.running and not controller.power_event(PowerEvent.BRAKE_RELEASE):
        raise HttpError(CONFLICT, f"the brakes cannot be released: the safety mode is {controller.safety.mode.name}")
    yield from _reached(controller, PowerState.RUNNING)


def _power_off(controller: Controller) -> _Waiting:
    controller.power_event(PowerEvent.POWER_OFF)
    yield from _reached(controller, PowerState.OFF)


def _reached(controller: Controller, *states: PowerState) -> Generator[None, None, None]:
    """Wait until the arm is in one of these states. Raises HttpError if it is switched off again or takes too long."""
    for period in range(round(_SWITCHING_S / controller.period_s)):
        if controller.power.state in states:
            return
        if period and controller.power.state is PowerState.OFF and PowerState.OFF not in states:
            raise HttpError(
                CONFLICT, f"the arm was switched off again: its safety mode is {controller.safety.mode.name}"
            )
        yield
    raise HttpError(TIMED_OUT, f"after {_SWITCHING_S:g} s the robot mode is {controller.power.robot_mode.name}")


def _unlock(controller: Controller) -> _Waiting:
    """Unlock immediately: the vendor's tests unlock within a second, which the dashboard would refuse for 5 s."""
    yield from ()
    if controller.safety.mode is not SafetyMode.PROTECTIVE_STOP:
        raise HttpError(CONFLICT, f"there is no protective stop: the safety mode is {controller.safety.mode.name}")
    if not controller.safety_event(SafetyEvent.UNLOCK):
        raise HttpError(CONFLICT, "the protective stop cannot be unlocked while its cause persists")


def _restart_safety(controller: Controller) -> _Waiting:
    dashboard.restart_safety(controller)
    yield from ()


_CHANGES: Final[dict[StateAction, Callable[[Controller], _Waiting]]] = {
    StateAction.POWER_ON: _power_on,
    StateAction.POWER_OFF: _power_off,
    StateAction.BRAKE_RELEASE: _brake_release,
    StateAction.UNLOCK_PROTECTIVE_STOP: _unlock,
    StateAction.RESTART_SAFETY: _restart_safety,
}


@endpoint(robotapi.GET_ROBOT_MODE)
def get_robot_mode(controller: Controller) -> RobotModeAnswer:
    """The robot mode."""
    return RobotModeAnswer(robot_word(controller.power.robot_mode), _OK)


@endpoint(robotapi.GET_SAFETY_MODE)
def get_safety_mode(controller: Controller) -> SafetyModeAnswer:
    """The safety mode."""
    return SafetyModeAnswer(safety_word(controller.safety.mode), _OK)


@endpoint(robotapi.GET_CONTROL_MODE)
def get_control_mode(controller: Controller) -> ControlModeAnswer:
    """Whether the robot is in local (LOCAL) or remote control (REMOTE). Only the pendant can change this."""
    return ControlModeAnswer("REMOTE" if controller.remote_control else "LOCAL", _OK)


@endpoint(robotapi.GET_OPERATIONAL_MODE)
def get_operational_mode(controller: Controller) -> OperationalModeAnswer:
    """The operational mode; AUTOMATIC unless it was set to MANUAL."""
    return OperationalModeAnswer("MANUAL" if controller.operational_mode == "MANUAL" else "AUTOMATIC", _OK)


# the loaded program


@endpoint(robotapi.PUT_LOAD)
def put_load(controller: Controller, program: LoadProgram) -> Generator[None, None, Done]:
    """Load a stored program. Since API 3.1.4, use PUT /program/v1/loaded."""
    yield from _load(controller, program.programName)
    return Done(robotapi.PROGRAM_LOADED)


@endpoint(robotapi.PUT_LOADED)
def put_loaded(controller: Controller, program: LoadedProgram) -> Generator[None, None, Done]:
    """Load a stored program; a running program is stopped."""
    yield from _load(controller, program.name)
    return Done(robotapi.PROGRAM_LOADED)


def _load(controller: Controller, name: str) -> Generator[None, None, None]:
    path = yield from find_program(controller, name)
    try:
        yield from dashboard.loading(controller, path)
    except (OSError, ValueError) as error:
        controller.messages.text(f"loading {name} failed: {error}")
        raise HttpError(INVALID, f"{name} is not loaded: {error}") from error


@endpoint(robotapi.GET_LOADED)
def get_loaded(controller: Controller) -> LoadedProgramAnswer:
    """The loaded program."""
    loaded = controller.programs.loaded
    return LoadedProgramAnswer(loaded.name if loaded else robotapi.DEFAULT_PROGRAM, _OK)


@endpoint(robotapi.PUT_PROGRAM_STATE)
def put_program_state(controller: Controller, change: ProgramStateChange) -> Generator[None, None, Done]:
    """Play, pause, resume or stop the loaded program. The answer comes when it is done."""
    paused = controller.programs.state is RuntimeState.PAUSED
    if change.action is ProgramAction.RESUME and not paused:
        raise HttpError(CONFLICT, "there is no paused program to resume")
    act, done = _ACTIONS[change.action]
    answer = yield from act(controller)
    if answer != done:
        mode, state = controller.power.robot_mode.name, controller.programs.state.name
        raise HttpError(CONFLICT, f"{change.action} is not possible: the robot mode is {mode}, the program {state}")
    return Done(_OK)


@endpoint(robotapi.GET_PROGRAM_STATE)
def get_program_state(controller: Controller) -> ProgramStateAnswer:
    """The state of the program."""
    return ProgramStateAnswer(dashboard.program_state_word(controller), _OK)


# stored programs


@endpoint(robotapi.GET_PROGRAMS)
def get_programs(controller: Controller) -> Generator[None, None, Programs]:
    """List the stored programs."""
    stored = yield from stored_programs(controller)
    return Programs([msgspec.convert(information.as_object(), Program) for _, information in stored], _OK)


@endpoint(robotapi.GET_PROGRAM)
def get_program(controller: Controller, name: str) -> Generator[None, None, bytes]:
    """Download a stored program as a .urpx file."""
    path = yield from find_program(controller, name)
    try:
        return read_file(path)
    except OSError as error:
        raise HttpError(CONFLICT, f"{name} cannot be read: {error.strerror or error}") from error


@endpoint(robotapi.POST_PROGRAM)
def post_program(controller: Controller, file: Upload) -> Generator[None, None, StoredProgram]:
    """Store a new program under the name in its file."""
    name = yield from store_program(controller, file, new=True)
    return StoredProgram(name, _OK)


@endpoint(robotapi.PUT_PROGRAM)
def put_program(controller: Controller, file: Upload) -> Generator[None, None, StoredProgram]:
    """Replace the stored program with the name in the file. A loaded program stays unchanged until loaded again."""
    name = yield from store_program(controller, file, new=False)
    return StoredProgram(name, _OK)
