"""The calls of each scenario, and what must be true of the robot when they return."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack, suppress
from typing import Final

from client import AsyncRobot, Robot, dashboard
from client.dashboard import DashboardClient
from client.driver import URDriver, points
from client.driver.control_program import LATE_TEXT
from client.rtde import RTDEClient
from tests.simulation.scenario import CONTROL_PROGRAM, HOME, ROBOT, Outcome, Scenario, play
from urproto.errors import URError
from urproto.external_control import TrajectoryResult
from urproto.modes import RobotMode

NEAR_RAD: Final = 0.01
_POWER_UP_S: Final = 90.0
_USABLE_S: Final = 90.0  # after the last accident, with some attempts
_PAUSE_S: Final = 1.0  # between them
_CLOSING_S: Final = 20.0
_LOOK_S: Final = 0.03  # between looks at the state
_SLACK_S: Final = 0.002  # of the age of a state: what the clock says between two ticks
_MESSAGE_S: Final = 0.5  # for a message of the robot on its way
_EXECUTE_S: Final = 5.0  # a program that is paused for an emergency stop never ends a motion


class FacadeScenario(Scenario):
    """`AsyncRobot`: motions, streams, settings, queries; at the end it must be usable again."""

    name = "AsyncRobot"

    async def use(self) -> None:
        try:
            arm = await self.call("connect", lambda: self._robot().__aenter__())
        except URError:
            self.heal()
            await asyncio.sleep(10.0)  # until the robot has booted
            arm = await self.call("connect again", lambda: self._robot().__aenter__())
        watching = asyncio.create_task(self._watch_state(arm))
        try:
            await self._work(arm)
            self.heal()
            await self._recover(arm)
        finally:
            watching.cancel()
            with suppress(URError):
                await self.call("close", lambda: arm.__aexit__(None, None, None), _CLOSING_S)

    def _robot(self) -> AsyncRobot:
        return AsyncRobot(ROBOT, realtime="off", reverse_port=50001)

    async def _work(self, arm: AsyncRobot) -> None:
        end_s = self.world.now + self.lasting_s
        while self.world.now < end_s:
            operation = self.random.choice(OPERATIONS)
            try:
                await operation(self, arm)
            except URError:
                with suppress(URError):
                    await self._get_ready(arm)

    async def _watch_state(self, arm: AsyncRobot) -> None:
        """Joint angles that are returned are those of a moment that is not longer ago than was permitted."""
        while True:
            with suppress(URError):
                self._check_state(arm)
            await asyncio.sleep(_LOOK_S)

    def _check_state(self, arm: AsyncRobot) -> None:
        state = arm._fresh
        now_s, limit_s = self.world.now, arm.driver.link.feed.max_age_s + _SLACK_S
        seen = [one for one in self.robot.history if abs(one.timestamp_s - state.timestamp_s) < 1e-6]
        if not any(one.q == state.q_rad for one in seen):
            self.problem(f"q was never so: {state.q_rad} at {state.timestamp_s}")
        elif now_s - seen[-1].now_s > limit_s:
            self.problem(f"q is {now_s - seen[-1].now_s:.3f} s old, more than {limit_s:.3f} s")

    async def _get_ready(self, arm: AsyncRobot) -> None:
        if arm.driver.protective_stopped:
            await self.call("recover", arm.recover)
        await self.call("make_ready", arm.make_ready, _POWER_UP_S)
        if self.robot.program != CONTROL_PROGRAM and not self._disturbed:
            self.problem(f"make_ready returned and the robot runs {self.robot.program or 'nothing'}")

    async def _recover(self, arm: AsyncRobot) -> None:
        """After all accidents, the same object moves the arm again."""
        until_s = self.world.now + _USABLE_S
        while True:
            try:
                await self._get_ready(arm)
                await move(self, arm)
                return
            except URError as error:
                if self.world.now > until_s:
                    self.problem(f"the arm cannot be moved {_USABLE_S:g} s after the last accident: {error!r}")
                    return
            self.heal()  # what began late may have ended since
            await asyncio.sleep(_PAUSE_S)

    # what calls promise

    @property
    def _disturbed(self) -> bool:
        """Whether something happened to the program in the last second, or is happening."""
        since_s = self.world.now - 1.0
        modes = {seen.modes for seen in self.robot.history if seen.now_s >= since_s}
        return len(modes) > 1 or not modes or self.world.now < self.network.line.cut_until_s

    def check_arrived(self, what: str, goal: tuple[float, ...]) -> None:
        """A motion has succeeded: the arm is there, and at rest."""
        q = self.robot.snapshot.actual_q
        distance = max(abs(a - b) for a, b in zip(q, goal, strict=True))
        if distance > NEAR_RAD:
            self.problem(f"{what} returned {distance:.3f} rad from its goal")

    def check_on_time(self, what: str, began_s: float) -> None:
        """The robot has not stopped the arm for a late setpoint, at least not so long ago that its message is there."""
        until_s = self.robot.snapshot.timestamp - _MESSAGE_S
        late = [line for line in self.robot.log if LATE_TEXT in line and began_s <= float(line.split()[0]) <= until_s]
        if late and not self._disturbed:
            self.problem(f"{what} returned, and setpoints were late: {late}")

    def check_rest(self, what: str) -> None:
        """The arm is at rest."""
        if not self.robot.at_rest and self.robot.program == CONTROL_PROGRAM:
            self.problem(f"{what} returned and the arm moves: {self.robot.snapshot.target_qd}")


Operation = Callable[[FacadeScenario, AsyncRobot], Awaitable[None]]


def _goal(scenario: FacadeScenario) -> tuple[float, ...]:
    return tuple(q + scenario.random.uniform(-0.15, 0.15) for q in HOME)


async def move(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    goal = _goal(scenario)
    await scenario.call("move_j", lambda: arm.move_j(goal, speed_rad_s=1.0))
    scenario.check_arrived("move_j", goal)
    scenario.check_rest("move_j")


async def _move_and_wait(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    goal = _goal(scenario)
    await scenario.call("move_j(wait=False)", lambda: arm.move_j(goal, wait=False))
    await asyncio.sleep(scenario.random.uniform(0.0, 0.5))
    await scenario.call("wait_done", arm.wait_done)
    scenario.check_arrived("wait_done", goal)


async def _move_and_stop(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    await scenario.call("move_j(wait=False)", lambda: arm.move_j(_goal(scenario), wait=False))
    await asyncio.sleep(scenario.random.uniform(0.0, 0.3))
    await scenario.call("stop", arm.stop)
    scenario.check_rest("stop")


async def _sequence(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    goals = [_goal(scenario) for _ in range(3)]
    await scenario.call("sequence", lambda: arm.sequence([points.movej(goal, v=1.0, a=4.0) for goal in goals]))
    scenario.check_arrived("sequence", goals[-1])


async def _servo(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    """A stream whose calls all return has been followed to its end, without a stop."""
    begin, began_s = arm.q, scenario.robot.snapshot.timestamp
    goal = tuple(q + 0.05 for q in begin)
    count = scenario.random.choice((20, 60))

    async def stream() -> None:
        async with arm.servo_j() as follow:
            for step in range(count):
                share = min(1.0, step / count)
                await follow([a + (b - a) * share for a, b in zip(begin, goal, strict=True)])
            until_s = scenario.world.now + 0.5
            while scenario.world.now < until_s:
                await follow(goal)

    await scenario.call("servo_j", stream)
    scenario.check_arrived("servo_j", goal)
    scenario.check_on_time("servo_j", began_s)
    scenario.check_rest("servo_j")


async def _speed(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    await scenario.call("speed_j", lambda: arm.speed_j([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], 0.3))
    scenario.check_rest("speed_j")


async def _output(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    number, on = scenario.random.randrange(8), scenario.random.random() < 0.5
    await scenario.call("set_digital_out", lambda: arm.set_digital_out(number, on))
    is_on = bool(scenario.robot.snapshot.actual_digital_output_bits >> number & 1)
    if is_on is not on and not scenario._disturbed:
        scenario.problem(f"set_digital_out returned and output {number} is {is_on}")


async def _slider(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    fraction = scenario.random.choice((0.5, 0.8, 1.0))
    await scenario.call("set_speed_slider", lambda: arm.set_speed_slider(fraction))


async def _query(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    pose = await scenario.call("forward", lambda: arm.kinematics.forward(HOME))
    if len(pose) != 6:
        scenario.problem(f"forward returned {pose}")


async def _mode(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    began_s = scenario.world.now
    mode = await scenario.call("dashboard.robot_mode", arm.dashboard.robot_mode)
    modes = {seen.modes[0] for seen in scenario.robot.history if seen.now_s >= began_s - 0.05}
    if modes and mode not in [RobotMode(value) for value in modes]:
        scenario.problem(f"robot_mode returned {mode!r}, and it was {modes}")


async def _program(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    """A program that is run to its end has been run, once."""
    text = f"seen {scenario.calls}"
    script = f'def once():\n  textmsg("{text}")\n  sleep(0.1)\nend\n'
    await scenario.call("programs.run", lambda: arm.programs.run(script, timeout_s=10.0))
    count = sum(line.endswith(text) for line in scenario.robot.log)
    if count != 1:
        scenario.problem(f"programs.run returned, and the program ran {count} times")


async def _register(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    """A register that was written has its value."""
    value = scenario.calls
    await scenario.call("set_int_register", lambda: arm.io.set_int_register(20, value))
    await asyncio.sleep(_LOOK_S)
    if scenario.robot.snapshot.input_int_registers[20] != value and not scenario._disturbed:
        scenario.problem(f"set_int_register returned, and its value is not {value}")


async def _pause(scenario: FacadeScenario, arm: AsyncRobot) -> None:
    await asyncio.sleep(scenario.random.uniform(0.0, 1.0))


OPERATIONS: Final[tuple[Operation, ...]] = (
    move, _move_and_wait, _move_and_stop, _sequence, _servo, _servo, _speed, _output, _slider, _query,
    _mode, _program, _register, _pause,
)  # fmt: skip


class UrcapScenario(FacadeScenario):
    """The same with the program of the pendant, in which the URCap's node fetches the control program."""

    name = "AsyncRobot with the URCap"
    models = (("ur3", None), ("ur5e", None))
    weights = (2, 1)

    def _robot(self) -> AsyncRobot:
        return AsyncRobot(ROBOT, realtime="off", headless=False, program=f"{CONTROL_PROGRAM}.urp")


class MastersScenario(Scenario):
    """Two drivers of one robot: the one that started its program last moves the arm, and no other."""

    name = "two URDriver"
    reverse_ports = frozenset({50001, 50011})

    async def use(self) -> None:
        async with AsyncExitStack() as drivers:
            masters = [await self._connect(drivers, first) for first in (50001, 50011)]
            end_s = self.world.now + self.lasting_s
            while self.world.now < end_s:
                await self._turn(*self.random.sample(masters, 2))
            self.heal()
            await asyncio.sleep(_PAUSE_S)

    async def _connect(self, drivers: AsyncExitStack, first: int) -> URDriver:
        names = ("reverse_port", "sender_port", "trajectory_port", "command_port")
        ports = {name: first + offset for offset, name in enumerate(names)}
        while True:
            driver = URDriver(ROBOT, realtime="off", **ports)
            try:
                await self.call("connect", driver.__aenter__)
            except URError:
                await asyncio.sleep(_PAUSE_S)
            else:
                drivers.push_async_callback(self._close, driver)
                return driver

    async def _close(self, driver: URDriver) -> None:
        with suppress(URError):
            await self.call("close", lambda: driver.__aexit__(None, None, None), _CLOSING_S)

    async def _turn(self, master: URDriver, other: URDriver) -> None:
        """One becomes the master and moves; what the other sends then has no effect, and is not reported as done."""
        starts = self.starts
        try:
            await self.call("start_program", master.start_program)
            if other.program_running and self.robot.program == CONTROL_PROGRAM and self.starts == starts + 1:
                await asyncio.sleep(0.3)
                if other.program_running and master.program_running:
                    self.problem("two drivers have a running program")
            goal = tuple(q + self.random.uniform(-0.1, 0.1) for q in HOME)
            moves = [points.movej(goal, v=1.0, a=4.0)]
            result = await self.call("execute", lambda: master.execute(moves, _EXECUTE_S))
            if result is TrajectoryResult.SUCCESS:
                distance = max(abs(a - b) for a, b in zip(self.robot.snapshot.actual_q, goal, strict=True))
                if distance > NEAR_RAD:
                    self.problem(f"execute returned {distance:.3f} rad from its goal")
        except URError:
            await asyncio.sleep(self.random.uniform(0.0, _PAUSE_S))
            return
        try:
            await self.call("execute of the other", lambda: other.execute([points.movej(HOME)], _EXECUTE_S))
        except URError:
            return
        if self.starts == starts + 1:
            self.problem("a driver whose program was replaced has moved the arm")

    @property
    def starts(self) -> int:
        """How many programs the robot has started."""
        return sum("PROGRAM_XXX_STARTED" in line for line in self.robot.log)


class PortsScenario(Scenario):
    """Clients of single ports: RTDE and the dashboard."""

    name = "RTDEClient and DashboardClient"

    async def use(self) -> None:
        await asyncio.gather(self._receive(), self._ask())
        self.heal()

    async def _receive(self) -> None:
        """States arrive in order, as the robot was, and none is missing without an error or a new connection."""
        outputs = ["timestamp", "actual_q"]
        end_s = self.world.now + self.lasting_s
        with suppress(URError):
            client = RTDEClient(ROBOT, outputs, [["input_int_register_24"]], reconnect_s=5.0)
            await self.call("RTDE connect", client.__aenter__)
            try:
                await self._follow(client, end_s)
            finally:
                await self.call("RTDE close", lambda: client.__aexit__(None, None, None), _CLOSING_S)

    async def _follow(self, client: RTDEClient, end_s: float) -> None:
        last_s, connections = -1.0, client.core.reconnects
        while self.world.now < end_s:
            state = await self.call("receive", client.receive, 60.0)
            timestamp_s = state["timestamp"]
            period_s = self.robot.emulator.controller.period_s
            same = client.core.reconnects == connections and last_s >= 0.0
            if same and abs(timestamp_s - last_s - period_s) > 1e-6:
                self.problem(f"after the state of {last_s} came that of {timestamp_s}")
            last_s, connections = timestamp_s, client.core.reconnects
            seen = [one for one in self.robot.history if abs(one.timestamp_s - timestamp_s) < 1e-6]
            known_s = max(self.robot.history[0].timestamp_s, self.robot.ambiguous_until_s)
            if known_s < timestamp_s and not any(one.q == state["actual_q"] for one in seen):
                self.problem(f"the robot was never as received: {state}")
            if self.random.random() < 0.05:
                await self.call("write", lambda: client.write(input_int_register_24=self.calls))

    async def _ask(self) -> None:
        end_s = self.world.now + self.lasting_s
        client = DashboardClient(ROBOT, timeout_s=2.0, reconnect_s=2.0)
        with suppress(URError):
            await self.call("dashboard connect", client.__aenter__)
        while self.world.now < end_s:
            began_s = self.world.now
            try:
                mode = await self.call("robotmode", lambda: client.request(dashboard.ROBOT_MODE))
                modes = {seen.modes[0] for seen in self.robot.history if seen.now_s >= began_s - 0.05}
                if modes and int(mode) not in modes:
                    self.problem(f"robotmode was answered with {mode!r}, and it was {modes}")
                await self.call("programState", lambda: client.request(dashboard.PROGRAM_STATE))
            except URError:
                await asyncio.sleep(0.1)
            await asyncio.sleep(self.random.uniform(0.0, 0.2))
        await self.call("dashboard close", client.close, _CLOSING_S)


class BlockingScenario(Scenario):
    """`Robot`, whose event loop runs in a thread: motions, streams of setpoints from this one."""

    name = "Robot"

    async def use(self) -> None:
        await asyncio.to_thread(self._use)

    def _use(self) -> None:
        for _ in range(30):
            try:
                with Robot(ROBOT, realtime="off", reverse_port=50001) as arm:
                    self._work(arm)
                return
            except URError as error:
                self.world.note(f"Robot raised {error!r}")
            except Exception as error:
                self.problem(f"Robot raised {error!r}")
                return
            self.heal()
            time.sleep(_PAUSE_S)
        self.problem("the robot cannot be used any more")

    def _work(self, arm: Robot) -> None:
        if arm.driver.protective_stopped:
            arm.recover()
        arm.make_ready()
        end_s = self.world.now + self.lasting_s
        while self.world.now < end_s:
            self.calls += 1
            goal = tuple(q + self.random.uniform(-0.1, 0.1) for q in HOME)
            if self.random.random() < 0.5:
                arm.move_j(goal, speed_rad_s=1.0)
            else:
                with arm.servo_j() as follow:
                    begin = arm.q
                    for step in range(150):
                        share = min(1.0, step / 100)
                        follow([a + (b - a) * share for a, b in zip(begin, goal, strict=True)])
            distance = max(abs(a - b) for a, b in zip(self.robot.snapshot.actual_q, goal, strict=True))
            if distance > NEAR_RAD:
                self.problem(f"a motion returned {distance:.3f} rad from its goal")
            if not self.robot.at_rest and self.robot.program == CONTROL_PROGRAM:
                self.problem("a motion returned and the arm moves")


SCENARIOS: Final = (
    FacadeScenario, MastersScenario, FacadeScenario, PortsScenario, FacadeScenario, BlockingScenario, UrcapScenario,
)  # fmt: skip


def play_seed(seed: int, trace: Callable[[str], object] | None = None) -> Outcome:
    """Play the scenario of a seed."""
    return play(seed, SCENARIOS[seed % len(SCENARIOS)], trace)
