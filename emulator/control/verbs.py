"""Verbs: typed methods that can also be called by name, with arguments from JSON or a command line."""

import inspect
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar, cast, get_type_hints

import msgspec

from urproto.controlapi import BadArguments, NotPossible

if TYPE_CHECKING:
    from emulator.controller import Controller


_T = TypeVar("_T")
Waiting = Generator[None, None, _T]  # yields once for each control period it waits; returns the verb's result

_ABSURD: Final = 1e30  # a timestamp in ns is far below
_MARK: Final = "__verb__"


class ControlledRobot(ABC):
    """The robot that verbs act on. ``controller``: a new object after the robot was switched off and on.

    ``go_on_from``: if set, replaces the robot by the one at the end of a journal.
    """

    def __init__(self, controller: "Controller") -> None:
        self.controller = controller
        self.go_on_from: Callable[[bytes], Waiting[None]] | None = None

    @abstractmethod
    def wait(self, steps: "Waiting[_T]") -> _T:
        """Let control periods pass until the steps are done; return their result."""


class ServedRobot(ControlledRobot):
    """A controller that something else drives, which continues the steps of a verb after each control period."""

    def wait(self, steps: "Waiting[_T]") -> _T:
        return cast(_T, steps)


@contextmanager
def refusing(kind: type[BadArguments | NotPossible]) -> Iterator[None]:
    """Turn the errors that signals, registers, files and the like raise for what they are given into one of a verb."""
    try:
        yield
    except (IndexError, OverflowError, ValueError) as error:
        raise kind(str(error)) from error


class Verbs:
    """The verbs of one subject: methods marked by `verb`, which run between two control periods.

    changes: whether they change the robot, other than its time.
    """

    changes: ClassVar[bool] = True

    def __init__(self, robot: ControlledRobot) -> None:
        self._robot = robot

    @property
    def controller(self) -> "Controller":
        return self._robot.controller

    def _wait(self, steps: "Waiting[_T]") -> _T:
        """Wait as the robot does. Must be the last action of a verb: a server continues the steps later."""
        return self._robot.wait(steps)


_Function = TypeVar("_Function", bound=Callable[..., Any])


def verb(function: _Function) -> _Function:
    """Make a method a verb: its annotations define the arguments, its docstring is the documentation."""
    setattr(function, _MARK, True)
    return function


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb for callers that use its name. ``parameters``: a msgspec structure of its arguments.

    ``open``: it also takes other arguments (``**``), and checks them itself.
    """

    name: str
    parameters: type[msgspec.Struct]
    result: Any
    text: str
    open: bool = False

    @property
    def summary(self) -> str:
        return self.text.partition("\n")[0]

    @property
    def arguments(self) -> tuple[str, ...]:
        return self.parameters.__struct_fields__

    def call(self, control: object, arguments: Mapping[str, Any], *, typed: bool = True) -> Any:
        """Call the verb of an object. Raises BadArguments.

        ``typed``: numbers are numbers, as in JSON; otherwise they may be text, as on a command line.
        """
        try:
            values = msgspec.convert(arguments, self.parameters, strict=typed)
        except msgspec.ValidationError as error:
            raise BadArguments(f"{self.name}: {error}") from error
        given = {name: getattr(values, name) for name in self.arguments}
        if self.open:
            given |= {name: value for name, value in arguments.items() if name not in given}
        for name, value in given.items():
            if not _finite(value):
                raise BadArguments(f"{self.name}: {name} must be finite and below 1e30, not {value}")
        return getattr(control, self.name)(**given)


def verbs_of(subjects: Iterable[type[Verbs]]) -> dict[str, Verb]:
    """The verbs of some subjects by name, in the order of their definition."""
    return {name: _described(name, function) for subject in subjects for name, function in _marked(subject)}


def methods_of(subject: Verbs) -> dict[str, Callable[..., Any]]:
    """The verbs of one subject of a robot as bound methods, by name."""
    return {name: getattr(subject, name) for name, _ in _marked(type(subject))}


def _marked(subject: type[Verbs]) -> Iterator[tuple[str, Callable[..., Any]]]:
    return ((name, member) for name, member in vars(subject).items() if getattr(member, _MARK, False))


def _described(name: str, function: Callable[..., Any]) -> Verb:
    hints = get_type_hints(function)
    fields: list[Any] = []
    named = list(inspect.signature(function).parameters.values())[1:]
    others = [parameter for parameter in named if parameter.kind is inspect.Parameter.VAR_KEYWORD]
    for parameter in named[: len(named) - len(others)]:
        field = (parameter.name, hints[parameter.name])
        optional = parameter.default is not inspect.Parameter.empty
        fields.append((*field, parameter.default) if optional else field)
    title = "".join(word.capitalize() for word in name.split("_"))
    parameters = msgspec.defstruct(title, fields, forbid_unknown_fields=not others, kw_only=True)
    return Verb(name, parameters, hints.get("return", Any), inspect.getdoc(function) or "", bool(others))


def _finite(value: object) -> bool:
    if isinstance(value, float | int):
        return abs(value) < _ABSURD
    if isinstance(value, list | tuple):
        return all(map(_finite, value))
    return not isinstance(value, dict) or all(map(_finite, value.values()))
