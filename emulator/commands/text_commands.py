"""The controller's own text commands on the script ports. They are no URScript.

One decorated function a command; case and spacing do not matter. Which exist: the public
client libraries use the first five; ``pause program``, ``resume program`` and ``set speed``
are habits of older clients. ``answer question`` and ``cancel question`` are the emulator's
own: how the pendant's software answers a program's question is not public.
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
_MOST_WORDS: Final = 4  # of a command's name


def execute(controller: Controller, line: str) -> bool:
    """Carry out a line if it is a text command; False when it is not (then it is URScript)."""
    said = words(line.split("#", 1)[0])
    for count in range(min(len(said), _MOST_WORDS), 0, -1):
        command = lower(" ".join(said[:count]))
        handler = TEXT_COMMANDS.get(command)
        if handler is not None:
            argument = " ".join(said[count:])
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
    """Switch the arm on; ends in IDLE."""
    controller.power_event(PowerEvent.POWER_ON)


@_text_command("power off")
def _power_off(controller: Controller, _: str) -> None:
    """Switch the arm off."""
    controller.power_event(PowerEvent.POWER_OFF)


@_text_command("set robotmode run")
def _run(controller: Controller, _: str) -> None:
    """Release the brakes, switching the arm on first if need be."""
    controller.power_event(PowerEvent.BRAKE_RELEASE)


@_text_command("set unlock protective stop")
def _unlock(controller: Controller, _: str) -> None:
    """Leave a protective stop at once; the 5 s of the dashboard do not apply here."""
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
    """Let a paused program go on, unless the safety system holds the arm."""
    if controller.may_run:
        controller.programs.resume()


@_text_command("run program")
def _run_program(controller: Controller, _: str) -> None:
    """Left from controllers that ran a program only on request: it already runs."""
    controller.messages.note("'run program' ignored: programs start when their text is complete")


@_text_command("set speed", argument=True)
def _set_speed(controller: Controller, argument: str) -> None:
    """Speed slider, 0 to 1."""
    try:
        controller.speed.set_slider(number(argument))
    except ValueError:
        controller.messages.note(f"'set speed {argument}' ignored: give a number from 0 to 1")


@_text_command("set sim")
def _set_sim(controller: Controller, _: str) -> None:
    """Simulation: programs move a simulated arm, and the real one stands; refused while anything moves."""
    _simulate(controller, on=True)


@_text_command("set real")
def _set_real(controller: Controller, _: str) -> None:
    """Back to the real robot, which is where it was; refused while anything moves."""
    _simulate(controller, on=False)


def _simulate(controller: Controller, *, on: bool) -> None:
    try:
        controller.simulate(on)
    except ValueError as error:
        controller.messages.note(f"'set {'sim' if on else 'real'}' refused: {error}")


@_text_command("answer question", argument=True)
def _answer(controller: Controller, argument: str) -> None:
    """Answer the question a program asks the operator: a number, a text, or true, yes, false, no."""
    try:
        controller.popups.answer_typed(argument)
    except ValueError as error:
        controller.messages.text(f"'answer question' ignored: {error}")


@_text_command("cancel question")
def _cancel(controller: Controller, _: str) -> None:
    """Close the question without an answer, as with the dialogue's Cancel: the program that asked ends."""
    try:
        controller.popups.answer(controller.popups.question.request_id, None)
    except ValueError as error:
        controller.messages.text(f"'cancel question' ignored: {error}")
