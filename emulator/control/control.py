"""All verbs of a robot as one Python object: `Control`, and `LiveControl` for a robot with ports.

The verbs of each subject form a separate class, which is independent of the others. To add a verb, mark a method of
such a class; to add a subject, name its class in ``SUBJECTS`` and among the bases of ``VerbMethods``.
"""

import inspect
from base64 import b64encode
from collections.abc import Callable, Mapping
from functools import wraps
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from emulator.control.debugging import DebuggingVerbs
from emulator.control.installation import InstallationVerbs
from emulator.control.modes import ModeVerbs, SignalVerbs
from emulator.control.programs import ProgramVerbs
from emulator.control.state import StateVerbs
from emulator.control.timing import Pace, TimeVerbs
from emulator.control.verbs import ControlledRobot, ServedRobot, Verbs, Waiting, methods_of, verb
from emulator.control.world import WorldVerbs
from emulator.controller import Controller
from emulator.faults.catalogue import kinds, make_fault
from emulator.faults.fault import FaultError, FaultImpossibleError
from emulator.faults.injector import FaultInjector
from emulator.servers.port import Port
from urproto.controlapi import BadArguments, NotPossible

_T = TypeVar("_T")


class FaultVerbs(Verbs):
    """Verbs about faults."""

    def __init__(self, robot: ControlledRobot, faults: FaultInjector) -> None:
        super().__init__(robot)
        self._faults = faults

    @verb
    def inject_fault(self, kind: str, **arguments: Any) -> int:
        """Inject a fault and return its id. ``fault_kinds`` lists the kinds and their arguments.

        For example ``drop_connection port=rtde after=5``, ``delay port=rtde delay_s=0.05 lasting=10``.
        """
        try:
            return self._faults.inject(make_fault(kind, arguments))
        except FaultError as error:
            raise BadArguments(str(error)) from error
        except FaultImpossibleError as error:
            raise NotPossible(f"{kind}: {error}") from error

    @verb
    def clear_fault(self, fault_id: int) -> None:
        """End a fault, or cancel one that has not begun."""
        if not self._faults.clear(fault_id):
            raise NotPossible(f"no fault {fault_id} waits or is in force: faults lists them")

    @verb
    def clear_faults(self) -> None:
        """End every fault."""
        self._faults.clear_all()

    @verb
    def faults(self) -> list[dict[str, Any]]:
        """List the faults that wait, are in force, or are over (the last hundred), and how often each struck."""
        return self._faults.listing()

    @verb
    def fault_kinds(self) -> list[dict[str, Any]]:
        """List the kinds of faults: kind, text, occasion on which one strikes, arguments with types and defaults."""
        return kinds()


class PortVerbs(Verbs):
    """Verbs about a robot's ports, their clients, and its process.

    ``pendant_report``: returns the state of the teach pendant. ``journal``: the recorded run, empty if there is none.
    """

    changes = False

    def __init__(
        self,
        robot: ControlledRobot,
        ports: Mapping[str, Port],
        pendant_report: Callable[[], dict[str, Any]],
        journal: Callable[[], bytes],
    ) -> None:
        super().__init__(robot)
        self._ports = ports
        self._journal = journal
        self._pendant_report = pendant_report

    @verb
    def ports(self) -> dict[str, int]:
        """The port each server listens on, by its name."""
        return {name: server.port for name, server in self._ports.items()}

    @verb
    def connections(self) -> dict[str, list[str]]:
        """List the clients of each port: their addresses, in the order in which they connected."""
        return {name: server.peers for name, server in self._ports.items()}

    @verb
    def turned_away(self) -> dict[str, dict[str, int]]:
        """Count the clients that each port has turned away since the start, by reason; only ports that did so.

        http, tls: the client sent what web browsers send; port full, address full: more clients than the limits allow;
        no descriptors: the process cannot open more files and connections; invalid data, not reading, no memory: the
        client was disconnected for this reason; wrong token: it sent one to the control API.
        """
        return {name: counts for name, server in self._ports.items() if (counts := server.turned_away.counts)}

    @verb
    def journal(self) -> str:
        """Everything that has entered the robot, in base64, for ``ur-emulator replay``: the last ten minutes, or more.

        It begins at the start, later at a moment without a program. ``ur-emulator ctl journal --file run.journal``
        writes it to a file.
        """
        if not (content := self._journal()):
            why = (
                "it is in the file of --journal, the robot was not made from options, or a program has run for so long "
                "that 32 MB were full; a new journal begins once no program runs and the arm is at rest"
            )
            raise NotPossible(f"the run is not in memory: {why}")
        return b64encode(content).decode()

    @verb
    def pendant(self) -> dict[str, Any]:
        """The teach pendant's process: state (none, starting, running, waiting, given up), port, pid, starts, problem.

        A process that was killed or crashed is restarted, after a longer wait each time; ``problem`` says why the last
        one ended.
        """
        return {"state": "none", "port": None, "pid": None, "starts": 0, "problem": ""} | self._pendant_report()


if TYPE_CHECKING:

    class VerbMethods(
        StateVerbs,
        SignalVerbs,
        ModeVerbs,
        WorldVerbs,
        InstallationVerbs,
        ProgramVerbs,
        TimeVerbs,
        FaultVerbs,
        DebuggingVerbs,
    ):
        """What a type checker sees: each verb as a method."""

    class _MethodsOfPorts(PortVerbs):
        """The verbs of a robot with ports in addition."""

else:
    VerbMethods = _MethodsOfPorts = object


class Control(VerbMethods):
    """The verbs of a robot, each as a method; what records its controller records those that may change it.

    ``pace``: controls how its time advances. ``client``: address and port of the caller; "" is this process.
    """

    SUBJECTS: ClassVar[tuple[type[Verbs], ...]] = (
        FaultVerbs,
        TimeVerbs,
        ProgramVerbs,
        InstallationVerbs,
        WorldVerbs,
        ModeVerbs,
        SignalVerbs,
        StateVerbs,
        DebuggingVerbs,
    )

    def __init__(self, robot: ControlledRobot, pace: Pace, faults: FaultInjector) -> None:
        self._robot = robot
        self.pace = pace
        self.client = ""
        self._take(FaultVerbs(robot, faults))
        self._take(TimeVerbs(robot, pace))
        for subject in Control.SUBJECTS[2:]:  # they act on the robot alone
            self._take(subject(robot))

    @property
    def controller(self) -> Controller:
        """The robot's controller; a new object after the robot was switched off and on."""
        return self._robot.controller

    def _take(self, subject: Verbs) -> None:
        for name, method in methods_of(subject).items():
            vars(self)[name] = self._recorded(name, method) if subject.changes else method

    def _recorded(self, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(method)
        def call(*values: Any, **named: Any) -> Any:
            self.controller.published()  # the state of the last period, before the verb changes anything
            if (recorder := self.controller.recorder) is None:
                return method(*values, **named)
            signature = inspect.signature(method)
            bound = signature.bind(*values, **named)
            arguments = dict(zip(signature.parameters, bound.args, strict=False)) | bound.kwargs
            return recorder.called(name, arguments, lambda: method(*values, **named), self.client)

        return call


class LiveControl(Control, _MethodsOfPorts):
    """Control with verbs about ports. A verb that takes time returns its steps, which a server continues."""

    SUBJECTS: ClassVar[tuple[type[Verbs], ...]] = (*Control.SUBJECTS, PortVerbs)

    def __init__(
        self,
        controller: Controller,
        pace: Pace,
        ports: Mapping[str, Port],
        faults: FaultInjector,
        journal: Callable[[], bytes] = bytes,
        go_on_from: Callable[[bytes], Waiting[None]] | None = None,
    ) -> None:
        robot = ServedRobot(controller)
        robot.go_on_from = go_on_from
        super().__init__(robot, pace, faults)
        self.pendant_report: Callable[[], dict[str, Any]] = dict
        self._take(PortVerbs(robot, ports, lambda: self.pendant_report(), journal))

    def switched_on(self, controller: Controller) -> None:
        """Use the robot's new controller from now on."""
        self._robot.controller = controller


def is_waiting(result: Any) -> bool:
    """Whether a verb returned steps instead of its result."""
    return hasattr(result, "__next__")
