"""One run of the program under a schedule: the robot, monitors of the properties, and what was new in it."""

import heapq
import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, Final

from emulator.builtins.host import ProgramHost
from emulator.control.conditions import Read
from emulator.controller import Controller
from emulator.explore.choices import CallVerb, Decision, Kind, PlanError, Schedule, Values
from emulator.explore.disturbances import PeerDisturbance
from emulator.explore.plan import Plan
from emulator.explore.properties import Monitor
from emulator.explore.session import Player
from emulator.peers.file import read_peers
from emulator.peers.log import PeersError
from emulator.services.sockets import NoNetwork
from emulator.snapshot import Snapshot
from emulator.virtual import VirtualRobot, replayed_robot, virtual_robot
from urproto.controlapi import BadArguments, NotPossible
from urproto.modes import RuntimeState
from urproto.primary.messages import ErrorCodeMessage, KeyMessage, RuntimeExceptionMessage
from urscript.files import ScriptFile
from urscript.runtime import ScriptThread

_STOPPING: Final = frozenset({"protective_stop", "press_emergency_stop", "open_safeguard", "trip_safety", "power_off"})
_WAITING_S: Final = 0.5  # without a statement, with the arm at rest
_FEW: Final = 4  # up to which values of variables differ, beyond it their powers of two
_MARGIN_STEPS: Final = 4  # for each power of ten

Feature = Hashable


@dataclass(frozen=True)
class Trail:
    """What a run was like. features: what happened, and in which period first. broken: properties with the reason."""

    schedule: Schedule
    features: dict[Feature, int]
    broken: dict[str, str]
    margins: dict[str, float]
    periods: int
    refused: tuple[str, ...] = ()


@dataclass
class _View:
    """What properties can refer to beside the fields of a snapshot."""

    robot: VirtualRobot
    exceptions: int = 0
    last_statement: int = 0
    wanted_stop: bool = False
    actions_left: int = 0

    def read(self, name: str) -> Read | None:
        """The value that a name with a dot stands for; None for an unknown name."""
        group, _, rest = name.partition(".")
        if group == "var":
            return lambda snapshot: self._controller.programs.variables.get(rest)
        if group in ("input", "output") and rest.isdecimal():
            bits, mask = f"actual_digital_{group}_bits", 1 << int(rest)
            return lambda snapshot: bool(getattr(snapshot, bits) & mask)
        if group == "object" and (world := self._controller.world) is not None and rest in world.poses():
            return lambda snapshot: world.pose(rest)
        return {
            "program.running": lambda snapshot: self._controller.programs.busy,
            "program.exceptions": lambda snapshot: self.exceptions,
            "program.going_on": self._going_on,
            "program.waits": self._waits,
            "tool.speed": lambda snapshot: math.hypot(*snapshot.actual_TCP_speed[:3]),
            "arm.moving": lambda snapshot: any(snapshot.actual_qd),
            "safety.stopped": lambda snapshot: self._controller.safety.stopped,
            "safety.unexpected": lambda snapshot: self._controller.safety.stopped and not self.wanted_stop,
            "choices.over": lambda snapshot: not self.actions_left,
        }.get(name)

    @property
    def _controller(self) -> Controller:
        return self.robot.controller

    def _going_on(self, snapshot: Snapshot) -> bool:
        programs = self._controller.programs
        return not self._controller.safety.stopped and programs.state in (RuntimeState.PLAYING, RuntimeState.STOPPED)

    def _waits(self, snapshot: Snapshot) -> bool:
        since = self._controller.step_count - self.last_statement
        playing = snapshot.runtime_state == RuntimeState.PLAYING
        return playing and not any(snapshot.actual_qd) and since * self._controller.period_s > _WAITING_S


class Run:
    """A run as far as it has come, which ends early if a property is broken. last: its periods if it does not.

    checked: whether replays of its journal are compared in each period. Raises PlanError for a plan that no robot can
    follow.
    """

    def __init__(self, plan: Plan, *, checked: bool = False) -> None:
        self._plan = plan
        try:
            if plan.session is not None:
                self.robot = replayed_robot(plan.session.beginning, checked=checked)
            else:
                self.robot = virtual_robot(plan.model, running=True, checked=checked, **plan.options)
            units = ScriptFile.read(str(plan.program)).units if plan.program is not None else ()
            if plan.peers is not None:  # the recorder comes outside the disturbances
                read_peers(plan.peers).attach(self.robot.controller, NoNetwork())
        except (ValueError, TypeError, NotPossible, BadArguments, PeersError) as error:
            raise PlanError(str(error)) from error
        except OSError as error:
            raise PlanError(f"{error.filename}: {error.strerror}") from error
        self.periods = 0
        self.last = round(plan.lasts_s / self.robot.controller.period_s)
        controller = self.robot.controller
        backend = NoNetwork() if plan.peers is None else controller.programs.socket_backend
        self.peers = PeerDisturbance(backend, lambda: self.robot.controller.time_s)
        controller.programs.socket_backend = self.peers
        if controller.recorder is not None:
            controller.recorder.wrap_backends(controller)
        self._view = _View(self.robot)
        self._monitors: dict[str, Monitor] = {one.name: one.monitor(self._view.read) for one in plan.properties}
        self._seen: Controller | None = None
        self._features: dict[Feature, int] = {}
        self._modes: Feature = None
        self._lines: dict[str, int] = {}
        self._variables: dict[str, Any] = {}
        self._nearest: dict[str, int] = {}  # when the margins of properties were least
        self._agenda: list[tuple[int, int, str, Kind, Values]] = []
        self._order = count()
        self._refused: list[str] = []
        self._broken = False
        self._watch()
        self.sending = Player(plan.session.messages if plan.session is not None else (), self.robot)
        for unit in units:
            if not self.robot.send_script(unit.text):
                raise PlanError(f"{plan.program}: the program does not start: {' '.join(self.robot.log(3))}")

    @property
    def period_s(self) -> float:
        return self.robot.controller.period_s

    @property
    def journal(self) -> bytes:
        return self.robot.journal

    def advance(self, schedule: Sequence[Decision], until: int) -> None:
        """Make the decisions of a schedule, and let time pass until a number of periods is over."""
        for decision in schedule:
            choice = self._plan.choices[decision.choice]
            for delay_s, kind, values in choice.actions(dict(decision.values)):
                at = decision.period + round(delay_s / self.period_s)
                heapq.heappush(self._agenda, (at, next(self._order), decision.choice, kind, values))
        while self.periods < min(until, self.last) and not self._broken:
            while self._agenda and self._agenda[0][0] <= self.periods:
                at, _, name, kind, values = heapq.heappop(self._agenda)
                self._act(name, kind, values, at)
            self._view.actions_left = len(self._agenda)
            self.sending.send(self.periods)
            now = self.periods
            self.robot.step(1)
            self.sending.go_on()
            if self.periods == now:  # the controller is off, or a new one is on
                self.periods += 1
                self._watch()

    def finish(self, schedule: Schedule, known: int = 0) -> Trail:
        """Go on to the end, with those decisions of a schedule that were not made yet: from number ``known`` on."""
        self.advance(schedule[known:], self.last)
        snapshot, time_s = self.robot.controller.snapshot, self._time_s
        for name, monitor in self._monitors.items():
            if not self._broken:
                monitor.end(snapshot, time_s)
            self._add_margin(name, monitor)
        return Trail(
            schedule,
            self._features,
            {name: monitor.broken for name, monitor in self._monitors.items() if monitor.broken},
            {name: monitor.margin for name, monitor in self._monitors.items()},
            self.periods,
            tuple(self._refused),
        )

    @property
    def _time_s(self) -> float:
        return self.periods * self.period_s

    def _act(self, name: str, kind: Kind, values: Values, period: int) -> None:
        try:
            kind.apply(self, values, period)
        except (NotPossible, BadArguments) as error:
            self._refused.append(f"{name}: {error}")
            return
        if isinstance(kind, CallVerb) and kind.name in _STOPPING:
            self._view.wanted_stop = True

    def _watch(self) -> None:
        controller = self.robot.controller
        if controller is not self._seen:  # it is a new one after a restart
            self._seen = controller
            controller.subscribe(self._look)
            controller.programs.step_hook = self._statement

    def _look(self, snapshot: Snapshot) -> None:
        """After each control period."""
        self.periods += 1
        modes = ("modes", snapshot.robot_mode, snapshot.safety_mode, snapshot.runtime_state)
        if modes != self._modes:
            self._new((self._modes, modes))
            self._modes = modes
        for message in snapshot.messages:
            if isinstance(message, RuntimeExceptionMessage):
                self._view.exceptions += 1
                self._new(("exception", message.text))
            elif isinstance(message, ErrorCodeMessage):
                self._new(("code", message.label))
            elif isinstance(message, KeyMessage):
                self._new(("key", message.title, message.text))
        self._new(("outputs", snapshot.actual_digital_output_bits))
        time_s = self._time_s
        for name, monitor in self._monitors.items():
            before = monitor.margin
            monitor.look(snapshot, time_s)
            if monitor.margin < before:
                self._nearest[name] = self.periods
            if monitor.broken:
                self._broken = True
        for name, value in self.robot.controller.programs.variables.items():
            if value is not self._variables.get(name) and isinstance(value, int):
                self._variables[name] = value
                self._new(("variable", name, value if abs(value) <= _FEW else math.copysign(value.bit_length(), value)))

    def _statement(self, host: ProgramHost, line: int, column: int, thread: ScriptThread) -> bool:
        self._view.last_statement = self.robot.controller.step_count
        self._new((thread.name, self._lines.get(thread.name, 0), line))
        self._lines[thread.name] = line
        return False

    def _new(self, feature: Feature) -> None:
        self._features.setdefault(feature, self.periods)

    def _add_margin(self, name: str, monitor: Monitor) -> None:
        if 0.0 < monitor.margin < math.inf:
            step = math.ceil(_MARGIN_STEPS * math.log10(monitor.margin))
            self._features["margin", name, step] = self._nearest.get(name, self.periods)
