"""The controller's own text commands on the script ports, which are not URScript.

There is one decorated function per command; case and spacing do not matter. Sources: public client libraries use the
commands about power, brakes, protective stops and ``stop program``; scripts that start simulators use ``confirm user
safety parameters``; older clients use ``pause program``, ``resume program`` and ``set speed``. ``answer question`` and
``cancel question`` are the emulator's own, because it is not public how the pendant's software answers a program's
question.
"""

from collections.abc import Callable
from typing import Final

from emulator.controller import Controller
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from urproto.text import lower, number, words

_Handler = Callable[[Controller, str], None]

TEXT_COMMANDS: Final[dict[str, _Handler]] = {}
_WITH_ARGUMENT: Final[set[str]] = set()
_MAX_WORDS: Final = 4  # of a command's name


def execute(controller: Controller, line: str) -> bool:
    """Execute a line if it is a text command; return False if it is not, and therefore URScript."""
    parts = words(line.split("#", 1)[0])
    for count in range(min(len(parts), _MAX_WORDS), 0, -1):
        command = lower(" ".join(parts[:count]))
        handler = TEXT_COMMANDS.get(command)
        if handler is not None:
            argument = " ".join(parts[count:])
            if bool(argument) != (command in _WITH_ARGUMENT):
                return False
            handler(controller, argument)
            return True
    return False


def _text_command(name: str, *, argument: bool = False) -> Callable[[_Handler], _Handler]:
    def register(handler: _Handler) -> _Handler:
        TEXT_COMMANDS[name] = handler
        if argument:
            _WITH_ARGUMENT.add(name)
        return handler

    return register


@_text_command("power on")
def _power_on(controller: Controller, _: str) -> None:
    """Switch the arm on; the robot mode becomes IDLE."""
    controller.power_event(PowerEvent.POWER_ON)


@_text_command("power off")
def _power_off(controller: Controller, _: str) -> None:
    """Switch the arm off."""
    controller.power_event(PowerEvent.POWER_OFF)


@_text_command("set robotmode run")
def _run(controller: Controller, _: str) -> None:
    """Release the brakes, switching the arm on first if necessary."""
    controller.power_event(PowerEvent.BRAKE_RELEASE)


@_text_command("confirm user safety parameters")
def _confirm_safety(controller: Controller, _: str) -> None:
    """Confirm the safety setup, as PolyScope does when it has started; RTDE sends no data until then."""
    controller.power_event(PowerEvent.CONFIRM)


@_text_command("set unlock protective stop")
def _unlock(controller: Controller, _: str) -> None:
    """Unlock a protective stop immediately; the 5 s of the dashboard do not apply here."""
    controller.safety_event(SafetyEvent.UNLOCK)


@_text_command("stop program")
def _stop(controller: Controller, _: str) -> None:
    """Stop the running program."""
    controller.programs.stop("stop program")


@_text_command("pause program")
def _pause(controller: Controller, _: str) -> None:
    """Pause the running program."""
    controller.programs.pause()


@_text_command("resume program")
def _resume(controller: Controller, _: str) -> None:
    """Resume a paused program, unless the safety system holds the arm."""
    if controller.may_run:
        controller.programs.resume()


@_text_command("run program")
def _run_program(controller: Controller, _: str) -> None:
    """Do nothing: old controllers ran a program only on this command; here it already runs."""
    controller.messages.note("'run program' ignored: programs start when their text is complete")


@_text_command("set speed", argument=True)
def _set_speed(controller: Controller, argument: str) -> None:
    """Set the speed slider, 0 to 1."""
    try:
        controller.speed.set_slider(number(argument))
    except ValueError:
        controller.messages.note(f"'set speed {argument}' ignored: give a number from 0 to 1")


@_text_command("set sim")
def _set_sim(controller: Controller, _: str) -> None:
    """Switch to simulation: programs move a simulated arm, the real one stands still. Refused while anything moves."""
    _simulate(controller, on=True)


@_text_command("set real")
def _set_real(controller: Controller, _: str) -> None:
    """Switch back to the real robot, which is where it was. Refused while anything moves."""
    _simulate(controller, on=False)


def _simulate(controller: Controller, *, on: bool) -> None:
    try:
        controller.simulate(on)
    except ValueError as error:
        controller.messages.note(f"'set {'sim' if on else 'real'}' refused: {error}")


@_text_command("answer question", argument=True)
def _answer(controller: Controller, argument: str) -> None:
    """Answer a program's question to the operator: a number, a text, or true, yes, false, no."""
    try:
        controller.popups.answer_typed(argument)
    except ValueError as error:
        controller.messages.text(f"'answer question' ignored: {error}")


@_text_command("cancel question")
def _cancel(controller: Controller, _: str) -> None:
    """Close the question without an answer, like Cancel in the dialogue: the program that asked ends."""
    try:
        controller.popups.answer(controller.popups.question.request_id, None)
    except ValueError as error:
        controller.messages.text(f"'cancel question' ignored: {error}")
