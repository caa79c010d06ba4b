"""A driver and a robot in one world, a network between them that fails, accidents, and a judge.

Everything follows from a seed: the robot, the line, the calls and the accidents. The judge sees both sides, which
nobody does in reality: what a call of the client returned, and what the robot is.
"""

import asyncio
import gc
import logging
import threading
import time
from collections import deque
from collections.abc import Awaitable, Callable, Generator, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from random import Random
from typing import Any, Final, TypeVar
from unittest.mock import patch

import emulator.clock
import emulator.servers.admission
from client.driver.script_sender import SENDER_PORT
from emulator.app import Emulator
from emulator.clock import RealClock, Tick
from emulator.config import EmulatorConfig
from emulator.control.control import is_waiting
from emulator.machine import ControllerConfig
from emulator.services.sockets import ScriptNetwork
from emulator.services.urcap import DriverAddress
from tests.simulation.network import Line, Network, Stream
from tests.simulation.world import HangError, SimulatedThread, World
from urproto.controlapi import BadArguments, NotPossible
from urproto.errors import URError
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

PC: Final = "10.0.0.1"
ROBOT: Final = "10.0.0.2"
OTHER_PC: Final = "10.0.0.3"
HOME: Final = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
CONTROL_PROGRAM: Final = "external_control"
REST_S: Final = 2.0  # the control program waits for at most 1 s, and a ramp to rest takes less than that
_CALL_S: Final = 30.0  # the sum of the timeouts of a call, if it has no other
_HOUR_S: Final = 250.0  # of virtual time, for a whole scenario
_KEPT_S: Final = 5.0  # for which the judge remembers what the robot was

Result = TypeVar("Result")


class _WatchedClock(RealClock):
    """Real time, which is virtual here; ``watch`` is called after each tick."""

    def __init__(self, period_s: float, watch: Callable[[], None]) -> None:
        super().__init__(period_s)
        self._watch = watch

    def start(self, tick: Tick) -> None:
        def both() -> None:
            tick()
            self._watch()

        super().start(both)


@dataclass
class Seen:
    """What the robot was after a control period."""

    now_s: float
    timestamp_s: float
    q: tuple[float, ...]
    modes: tuple[int, int, int]


class SimulatedRobot:
    """The emulator, in a thread of its own, at its own address."""

    def __init__(self, scenario: "Scenario", model: str, version: str | None) -> None:
        self.scenario = scenario
        self.history: deque[Seen] = deque()
        self.ambiguous_until_s = 0.0  # timestamps up to this have occurred before a restart, too
        self._waiting: list[Generator[None, None, object]] = []
        self.loop: asyncio.AbstractEventLoop
        self.emulator: Emulator
        self._model, self._version = model, version
        self._started = threading.Event()
        self._stop: asyncio.Event
        self._thread = threading.Thread(target=self._run, name="robot")
        assert isinstance(self._thread, SimulatedThread)
        self._thread.host = ROBOT

    def start(self) -> None:
        self._thread.start()
        self._started.wait()

    def stop(self) -> None:
        self.loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()

    def do(self, verb: str, **arguments: Any) -> None:
        """Carry out a verb of the control API, as soon as the robot's loop comes to it."""

        def carry_out() -> None:
            with suppress(NotPossible, BadArguments):
                result = getattr(self.emulator.control, verb)(**arguments)
                if is_waiting(result):
                    self._waiting.append(result)

        self.scenario.world.note(f"robot: {verb} {arguments}")
        self.loop.call_soon_threadsafe(carry_out)

    @property
    def snapshot(self) -> Any:
        return self.emulator.controller.snapshot

    @property
    def at_rest(self) -> bool:
        return max(map(abs, self.snapshot.target_qd)) < 1e-6

    @property
    def log(self) -> list[str]:
        return list(self.emulator.controller.messages.history)

    @property
    def program(self) -> str:
        """Name of the program that is running; empty without one."""
        programs = self.emulator.controller.programs
        return str(programs.name or "") if programs.state.name not in ("STOPPED", "STOPPING") else ""

    def _run(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.loop.run_until_complete(self._serve())
        self.loop.run_until_complete(self.loop.shutdown_default_executor())
        self.loop.close()

    async def _serve(self) -> None:
        version = PolyscopeVersion.parse(self._version) if self._version else None
        controller = ControllerConfig(
            model=load_model(self._model),
            version=version,
            initial_q=HOME,
            running=True,
            external_control=DriverAddress(PC, SENDER_PORT),
        )
        config = EmulatorConfig(
            controller=controller, host=ROBOT, control=False, script_network=ScriptNetwork.ANY_AND_CONTROL
        )
        clock = _WatchedClock(controller.model.series.period_s, self._watch)
        self.emulator = Emulator(config, clock)
        async with self.emulator:
            self._stop = asyncio.Event()
            self._started.set()
            await self._stop.wait()

    def _watch(self) -> None:
        for waiting in tuple(self._waiting):  # a verb that takes some periods
            try:
                next(waiting)
            except (StopIteration, NotPossible):
                self._waiting.remove(waiting)
        snapshot, now_s = self.snapshot, self.scenario.world.now
        if self.history and snapshot.timestamp < self.history[-1].timestamp_s:
            self.ambiguous_until_s = max(self.ambiguous_until_s, self.history[-1].timestamp_s)
        modes = int(snapshot.robot_mode), int(snapshot.safety_mode), int(snapshot.runtime_state)
        self.history.append(Seen(now_s, snapshot.timestamp, tuple(snapshot.actual_q), modes))
        while self.history[0].now_s < now_s - _KEPT_S:
            self.history.popleft()
        self.scenario.watch(now_s)


class _Log(logging.Handler):
    """Collects what no client or robot may write into the log."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__(logging.WARNING)
        self._problems = problems

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info and record.exc_info[1] is not None:
            if record.name.split(".")[0] in ("client", "asyncio", "emulator", "urproto", "concurrent"):
                self._problems.append(f"a traceback in the log: {record.getMessage()}: {_trace(record.exc_info[1])}")
        elif record.name == "asyncio" or record.levelno >= logging.CRITICAL:
            self._problems.append(f"in the log: {record.getMessage()}")


def _trace(error: BaseException) -> str:
    places = []
    trace = error.__traceback__
    while trace is not None:
        places.append(f"{trace.tb_frame.f_code.co_filename.rsplit('/', 1)[-1]}:{trace.tb_lineno}")
        trace = trace.tb_next
    return f"{error!r} at {' > '.join(places[-6:])}"


def _place(task: "asyncio.Task[Any]") -> str:
    """Where a task waits."""
    places, awaited = [], task.get_coro()
    while (frame := getattr(awaited, "cr_frame", None) or getattr(awaited, "gi_frame", None)) is not None:
        places.append(f"{frame.f_code.co_filename.rsplit('/', 1)[-1]}:{frame.f_lineno}")
        awaited = getattr(awaited, "cr_await", None) or getattr(awaited, "gi_yieldfrom", None)
    return f"{task.get_name()} at {' > '.join(places[-8:])} waits for {awaited}"


@dataclass
class Outcome:
    """What a run found. problems: empty if all is well."""

    seed: int
    title: str
    problems: list[str]
    digest: str
    events: int
    virtual_s: float
    calls: int
    errors: dict[str, int] = field(default_factory=dict)

    def __str__(self) -> str:
        lines = [f"seed {self.seed}: {self.title}; {self.calls} calls in {self.virtual_s:.1f} s, log {self.digest}"]
        lines += [f"    {problem}" for problem in self.problems]
        if self.problems:
            lines.append(f"    again: python -m tests.simulation {self.seed} --trace")
        return "\n".join(lines)


class Scenario:
    """One run. Subclasses have the calls of the client, in `use`."""

    name = ""
    models: tuple[tuple[str, str | None], ...] = (("ur3", None), ("ur5", None), ("ur5e", None), ("ur5e", "10.12"))
    weights: tuple[int, ...] = (6, 2, 1, 1)
    lasting_s = 3.0  # during which accidents happen

    def __init__(self, seed: int, world: World, network: Network) -> None:
        self.seed = seed
        self.world = world
        self.network = network
        self.random = Random(seed)
        self.problems: list[str] = []
        self.calls = 0
        self.errors: dict[str, int] = {}
        self.other_masters = 0  # programs of others that were sent to the robot
        self.half_open = False
        model, version = self.random.choices(self.models, self.weights)[0]
        self.robot = SimulatedRobot(self, model, version)
        self.model = model
        self._moving_since_s: float | None = None
        self._accidents: list[str] = []

    @property
    def title(self) -> str:
        return f"{self.name} of a {self.model}: {', '.join(self._accidents) or 'no accident'}"

    # judging

    def problem(self, text: str) -> None:
        """Note what must not be."""
        self.world.note(f"PROBLEM {text}")
        if len(self.problems) < 10:
            self.problems.append(f"at {self.world.elapsed_s:.3f} s: {text}")

    def watch(self, now_s: float) -> None:
        """What must be true after each control period."""
        robot = self.robot
        if robot.at_rest or robot.program != CONTROL_PROGRAM:
            self._moving_since_s = None
            return
        if self._moving_since_s is None:
            self._moving_since_s = now_s
        heard_s = max(
            (
                when
                for (local, remote), when in self.network.arrived_s.items()
                if local[0] == ROBOT and remote is not None and remote[1] in self.reverse_ports
            ),
            default=self._moving_since_s,
        )
        if now_s - max(heard_s, self._moving_since_s) > REST_S:
            self._moving_since_s = now_s + 1e9
            self.problem(f"the arm moves {now_s - heard_s:.2f} s after the last message of its driver")

    reverse_ports: frozenset[int] = frozenset({50001})

    async def call(self, name: str, make: Callable[[], Awaitable[Result]], within_s: float = _CALL_S) -> Result:
        """Call the client: raises its documented errors; everything else, and a call that takes too long, is wrong."""
        self.calls += 1
        began_s = self.world.now
        self.world.note(f"call {name}")
        try:
            result = await make()
        except URError as error:
            kind = type(error).__name__
            self.errors[kind] = self.errors.get(kind, 0) + 1
            self.world.note(f"{name} raised {kind}: {error}")
            if len(str(error)) < 20 or "\n" in str(error):
                self.problem(f"{name} explains nothing: {error!r}")
            raise
        except Exception as error:
            self.problem(f"{name} raised {_trace(error)}")
            raise UnexpectedError from error
        finally:
            if self.world.now - began_s > within_s:
                self.problem(f"{name} took {self.world.now - began_s:.1f} s, more than {within_s:g} s")
        self.world.note(f"{name} returned")
        return result

    # accidents

    def plan_accidents(self, loop: asyncio.AbstractEventLoop) -> None:
        """Choose the line, and what happens and when."""
        random, line = self.random, self.network.line
        line.latency_s = random.choice((0.0001, 0.0003, 0.002, 0.01))
        line.jitter_s = line.latency_s * random.random() * 2.0
        line.portion = random.choice((0.0, 0.1, 0.5))
        if random.random() < 0.3:
            line.slow, line.slow_s = random.choice((0.001, 0.01)), random.choice((0.02, 0.1, 0.4))
        for _ in range(random.choice((0, 1, 1, 1, 2, 2, 3))):
            when_s, accident = random.uniform(0.05, self.lasting_s), random.choice(ACCIDENTS)
            self._accidents.append(f"{accident.__name__.strip('_')} at {when_s:.2f} s")
            self.world.call_later(when_s, lambda act=accident: act(self, loop))  # type: ignore[misc]

    def heal(self) -> None:
        """From now on the network is good, and nothing prevents the arm from moving, except that it has to be freed."""
        self.world.note("healed")
        self.network.line = Line()
        for end, other in self.network.open:
            for stream in (end, other):
                for pipe in (stream.incoming, stream.outgoing):
                    if pipe is not None and pipe.blocked_until_s < float("inf"):
                        pipe.blocked_until_s = min(pipe.blocked_until_s, self.world.now)
        for verb in ("release_emergency_stop", "close_safeguard", "reset_safeguard"):
            self.robot.do(verb)

    @property
    def streams(self) -> list[Stream]:
        """Connections between the machines, their first ends."""
        return [first for first, _ in self.network.open]

    # running

    async def use(self) -> None:
        """Call the client."""
        raise NotImplementedError


class UnexpectedError(Exception):
    """An error that no client documents was raised; it is noted already."""


Accident = Callable[[Scenario, asyncio.AbstractEventLoop], None]


def _stall_one(scenario: Scenario, _: object) -> None:
    if streams := scenario.streams:
        scenario.network.stall(scenario.random.choice(streams), scenario.random.choice((0.05, 0.15, 0.3, 0.8, 2.5)))


def _cut(scenario: Scenario, _: object) -> None:
    scenario.network.cut(scenario.random.choice((0.05, 0.15, 0.3, 0.8, 1.5, 4.0, 8.0)))


def _reset_one(scenario: Scenario, _: object) -> None:
    if streams := scenario.streams:
        scenario.network.cut_off(scenario.random.choice(streams))


def _reset_all(scenario: Scenario, _: object) -> None:
    for stream in scenario.streams:
        scenario.network.cut_off(stream)


def _half_open_one(scenario: Scenario, _: object) -> None:
    scenario.half_open = True
    if streams := scenario.streams:
        scenario.network.stall(scenario.random.choice(streams), float("inf"))


def _half_open_all(scenario: Scenario, _: object) -> None:
    scenario.half_open = True
    for stream in scenario.streams:
        scenario.network.stall(stream, float("inf"))


def _hang(scenario: Scenario, loop: asyncio.AbstractEventLoop) -> None:
    seconds = scenario.random.choice((0.05, 0.25, 0.6, 1.5, 11.0))
    scenario.world.note(f"the client's event loop hangs for {seconds} s")
    loop.call_soon_threadsafe(lambda: time.sleep(seconds))


def _standstill(scenario: Scenario, _: object) -> None:
    scenario.world.stall(PC, scenario.random.choice((0.05, 0.25, 0.6, 1.5, 5.0)))


def _robot_stands_still(scenario: Scenario, _: object) -> None:
    scenario.world.stall(ROBOT, scenario.random.choice((0.02, 0.1, 0.2)))


def _protective_stop(scenario: Scenario, _: object) -> None:
    scenario.robot.do("protective_stop")


def _emergency_stop(scenario: Scenario, _: object) -> None:
    scenario.robot.do("press_emergency_stop")
    scenario.world.call_later(scenario.random.uniform(0.1, 2.0), lambda: scenario.robot.do("release_emergency_stop"))


def _safeguard(scenario: Scenario, _: object) -> None:
    scenario.robot.do("open_safeguard")
    scenario.world.call_later(scenario.random.uniform(0.1, 2.0), lambda: scenario.robot.do("close_safeguard"))


def _power_off(scenario: Scenario, _: object) -> None:
    scenario.robot.do("power_off")


def _stopped_by_user(scenario: Scenario, _: object) -> None:
    scenario.robot.do("dashboard", line="stop")


def _paused_by_user(scenario: Scenario, _: object) -> None:
    scenario.robot.do("dashboard", line="pause")
    scenario.world.call_later(scenario.random.uniform(0.1, 2.0), lambda: scenario.robot.do("dashboard", line="play"))


def _other_program(scenario: Scenario, _: object) -> None:
    scenario.other_masters += 1
    scenario.robot.do("send_script", text="def other():\n  sleep(0.3)\nend\n")


def _restart(scenario: Scenario, _: object) -> None:
    scenario.robot.do("inject_fault", kind="restart_controller", outage_s=scenario.random.choice((0.5, 2.0)))


def _power_loss(scenario: Scenario, _: object) -> None:
    scenario.half_open = True
    scenario.robot.do("inject_fault", kind="power_loss", lasting=scenario.random.choice((0.5, 2.0)))


ACCIDENTS: Final[tuple[Accident, ...]] = (
    _stall_one, _stall_one, _cut, _cut, _cut, _reset_one, _reset_one, _reset_all, _half_open_one, _half_open_all,
    _hang, _standstill, _robot_stands_still, _protective_stop, _emergency_stop, _safeguard, _power_off,
    _stopped_by_user, _paused_by_user, _other_program, _restart, _power_loss,
)  # fmt: skip


@contextmanager
def _logged(problems: list[str]) -> Iterator[None]:
    root, handler = logging.getLogger(), _Log(problems)
    root.addHandler(handler)
    try:
        yield
    finally:
        root.removeHandler(handler)


def play(seed: int, kind: type[Scenario], trace: Callable[[str], object] | None = None) -> Outcome:
    """Run a scenario."""
    problems: list[str] = []
    with (
        World(seed, PC, limit_s=_HOUR_S) as world,
        Network(world) as network,
        patch.object(emulator.clock, "_timer", emulator.clock._LoopTimer),
        patch.object(emulator.servers.admission, "_turns", emulator.servers.admission._Turns()),
        _logged(problems),
    ):
        world.trace = trace
        scenario = kind(seed, world, network)
        scenario.problems = problems
        scenario.robot.start()
        loop = asyncio.new_event_loop()
        try:
            scenario.plan_accidents(loop)
            before = set(network.descriptors)
            robots = list(world.threads)
            with suppress(UnexpectedError):
                loop.run_until_complete(scenario.use())
            if tasks := asyncio.all_tasks(loop):
                scenario.problem(f"tasks are left: {sorted(map(str, tasks))}")
            loop.run_until_complete(loop.shutdown_asyncgens())
            loop.run_until_complete(loop.shutdown_default_executor())
            if left := [thread.name for thread in world.threads if thread.host != ROBOT and thread not in robots]:
                scenario.problem(f"threads are left: {left}")
            own = [
                fd
                for fd, endpoint in network.descriptors.items()
                if fd not in before and endpoint.local[0] not in (ROBOT, "")
            ]
            if own:
                places = [f"{network.descriptors[fd].local} {network.descriptors[fd].remote}" for fd in own]
                scenario.problem(f"sockets are left: {places}")
            scenario.robot.stop()
        except HangError as hang:
            scenario.problem(f"a call hangs: {hang}\n" + "\n".join(map(_place, asyncio.all_tasks(loop))))
        except Exception as error:
            scenario.problem(f"the scenario failed: {_trace(error)}")
        finally:
            with suppress(Exception):
                loop.close()
        problems += world.failures
        outcome = Outcome(
            seed, scenario.title, problems, world.digest, world.events, world.elapsed_s, scenario.calls, scenario.errors
        )
    if problems:
        gc.collect()  # what it left behind is not the next one's
    return outcome
