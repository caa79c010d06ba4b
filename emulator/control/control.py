"""All verbs of a robot as one Python object; `emulator.control.control` adds those of its ports."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar, cast

from emulator.control.modes import ModeVerbs, SignalVerbs
from emulator.control.programs import ProgramVerbs
from emulator.control.state import StateVerbs
from emulator.control.timing import OwnPace, Pace, TimeVerbs
from emulator.control.verbs import BadArguments, ControlBase, NotPossible, Waiting, verb
from emulator.control.world import WorldVerbs
from emulator.controller import Controller
from emulator.faults.catalogue import kinds, make_fault
from emulator.faults.fault import FaultError, FaultImpossible, rebooted, show_gone
from emulator.faults.injector import FaultInjector
from emulator.machine import ControllerConfig
from emulator.servers.admission import TurnedAway


class FaultVerbs(ControlBase):
    """Verbs about what goes wrong."""

    _faults: FaultInjector

    @verb
    def inject_fault(self, kind: str, **arguments: Any) -> int:
        """Let a fault happen; its id. ``fault_kinds`` tells the kinds and their arguments.

        For example ``drop_connection port=rtde after=5``, ``delay port=rtde delay_s=0.05 lasting=10``.
        """
        try:
            return self._faults.inject(make_fault(kind, arguments))
        except FaultError as error:
            raise BadArguments(str(error)) from error
        except FaultImpossible as error:
            raise NotPossible(f"{kind}: {error}") from error

    @verb
    def clear_fault(self, fault_id: int) -> None:
        """End a fault, or take back one that waits."""
        if not self._faults.clear(fault_id):
            raise NotPossible(f"there is no fault {fault_id} that waits or is in force")

    @verb
    def clear_faults(self) -> None:
        """End every fault."""
        self._faults.clear_all()

    @verb
    def faults(self) -> list[dict[str, Any]]:
        """Faults that wait, are in force or are over (the last hundred), and how often each struck."""
        return self._faults.listing()

    @verb
    def fault_kinds(self) -> list[dict[str, Any]]:
        """What faults there are: kind, text, on what occasion one strikes, arguments with types and defaults."""
        return kinds()


_T = TypeVar("_T")


class Control(StateVerbs, SignalVerbs, ModeVerbs, WorldVerbs, ProgramVerbs, TimeVerbs, FaultVerbs):
    """The verbs of a robot."""

    def __init__(self, controller: Controller, pace: Pace, faults: FaultInjector) -> None:
        super().__init__(controller, pace)
        self._faults = faults


class VirtualRobot(Control):
    """A controller without ports in virtual time: ``step``, ``run_until`` and what waits make its time go by.

    robot = VirtualRobot(ControllerConfig(model=load_model("ur3")))
    robot.release_brakes()
    robot.run_until("robot_mode == RUNNING")
    """

    def __init__(self, config: ControllerConfig) -> None:
        controller = Controller(config)
        super().__init__(controller, OwnPace(), FaultInjector(controller, machine=self))
        self._power_wanted = True
        self._periods_off = 0
        self._boot_s = 0.0

    def switch_off(self, *, silent: bool) -> None:
        """The controller is gone after this period: a fault."""
        self._power_wanted = False

    def switch_on(self, boot_s: float) -> None:
        """A new controller boots; its uptime begins at 0."""
        self._power_wanted, self._boot_s = True, boot_s

    def _period(self) -> None:
        """One control period, with or without a controller."""
        if self._periods_off:
            self._periods_off += 1
            self._faults.step()
            if self._power_wanted:
                self._come_back()
            return
        self.controller.tick()
        if not self._power_wanted:
            self._periods_off = 1
            self._faults.controller_gone()
            self.controller.programs.stop("the controller ended")
            show_gone(self.controller)

    def _come_back(self) -> None:
        before, periods, self._periods_off = self.controller, self._periods_off, 0
        self.controller = rebooted(before, self._boot_s, periods * before.period_s)
        self.controller.programs.socket_backend = before.programs.socket_backend
        self._faults.controller_back(self.controller)

    def _wait(self, steps: Waiting[_T]) -> _T:
        while True:
            try:
                next(steps)
            except StopIteration as done:
                result: _T = done.value
                return result
            self._period()


class Port(Protocol):
    """What the verbs want to know of a server."""

    @property
    def port(self) -> int: ...

    @property
    def peers(self) -> list[str]: ...

    @property
    def turned_away(self) -> TurnedAway: ...


class LiveControl(Control):
    """As Control. A verb that takes time returns its steps: a server continues them after each control period."""

    def __init__(self, controller: Controller, pace: Pace, ports: Mapping[str, Port], faults: FaultInjector) -> None:
        super().__init__(controller, pace, faults)
        self._ports = ports
        self.pendant_report: Callable[[], dict[str, Any]] = dict

    @verb
    def ports(self) -> dict[str, int]:
        """The port each server listens on, by its name."""
        return {name: server.port for name, server in self._ports.items()}

    @verb
    def connections(self) -> dict[str, list[str]]:
        """Who is connected to each port: addresses of the clients, in the order they came."""
        return {name: server.peers for name, server in self._ports.items()}

    @verb
    def turned_away(self) -> dict[str, dict[str, int]]:
        """How many clients each port has turned away since the start, by reason; only ports that did.

        http, tls: what web browsers send; port full, address full: more clients than the limits allow;
        no descriptors: the process has no room for more files and connections.
        """
        return {name: counts for name, server in self._ports.items() if (counts := server.turned_away.counts)}

    @verb
    def pendant(self) -> dict[str, Any]:
        """The teach pendant's process: state (none, starting, running, waiting, given up), port, pid, starts, trouble.

        One that was killed or has crashed is started anew, later each time; ``trouble`` tells why the last one ended.
        """
        return {"state": "none", "port": None, "pid": None, "starts": 0, "trouble": ""} | self.pendant_report()

    def _wait(self, steps: Waiting[_T]) -> _T:
        return cast(_T, steps)


def is_waiting(result: Any) -> bool:
    """Whether a verb returned steps instead of its result."""
    return hasattr(result, "__next__")
