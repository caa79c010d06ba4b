"""The driver and the robot in one virtual world, with a network that fails: each seed is another story.

SIMULATED_SEEDS=100000 (``make soak``) plays so many of them; SIMULATED_FROM begins with another one.
"""

import asyncio
import logging
import os
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from client import AsyncRobot
from client.driver import URDriver, points
from client.errors import LateSetpointError, MotionError, NoAnswerError, ProgramEndedError
from client.primary import PrimaryClient
from tests.rows import each_row
from tests.simulation.clients import NEAR_RAD, play_seed
from tests.simulation.scenario import HOME, PC, ROBOT, Scenario, play
from urproto.errors import RobotRefused, URError
from urproto.modes import RobotMode

NOW: Final = 4  # about a second of CPU time each
SEEDS: Final = int(os.environ.get("SIMULATED_SEEDS", "200"))
FROM: Final = int(os.environ.get("SIMULATED_FROM", "1"))
AT_ONCE: Final = 200  # seeds of a test, of which each worker takes some
REPOSITORY: Final = Path(__file__).parents[2]


def failures(first: int, last: int) -> str:
    """What these seeds find; empty if all is well."""
    return "\n".join(str(outcome) for outcome in map(play_seed, range(first, last)) if outcome.problems)


def test_seeds() -> None:
    assert not failures(FROM, FROM + NOW)


@pytest.mark.long
@pytest.mark.timeout(0)
@pytest.mark.parametrize("first", range(FROM + NOW, FROM + SEEDS, AT_ONCE))
def test_more_seeds(first: int) -> None:
    assert not failures(first, min(first + AT_ONCE, FROM + SEEDS))


def test_same_seed_same_story() -> None:
    """Also in another process, whose hashes of strings, addresses of objects and caches are others."""
    here = [play_seed(7).digest for _ in range(2)]
    assert here[0] == here[1] != play_seed(13).digest
    command = [sys.executable, "-m", "tests.simulation", "7"]
    there = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    assert here[0] in there.stdout


# What seeds have found


class Calm(Scenario):
    """Without accidents of the seed: those of `use`."""

    models = (("ur3", None),)
    weights = (1,)

    def plan_accidents(self, loop: object) -> None: ...

    def silence(self, port: int) -> None:
        """Connections to a port of the robot are gone, and neither end is told."""
        for stream in self.streams:
            if stream.remote == (ROBOT, port):
                self.network.stall(stream, float("inf"))

    def silence_programs(self) -> None:
        """The same for the connections that the robot's programs have opened."""
        for stream in self.streams:
            if stream.local[0] == ROBOT:
                self.network.stall(stream, float("inf"))


class RestartDuringUse(Calm):
    """The controller is restarted: the same driver powers the arm on again, through a new dashboard connection."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("move_j", lambda: arm.move_j(moved(0.1)))
            self.robot.do("inject_fault", kind="restart_controller", outage_s=0.5)
            await self.call("the loss", lambda: lost(arm))
            await self.call("make_ready", lambda: again(arm.make_ready))
            await self.call("move_j", lambda: arm.move_j(moved(0.0)))


class RestartDuringAStop(Calm):
    """A protective stop ends with the controller's restart, and its clock begins anew: there is nothing to wait for."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            self.robot.do("protective_stop")
            await self.call("the stop", lambda: arm.wait_for(lambda _: arm.driver.protective_stopped))
            self.robot.do("inject_fault", kind="restart_controller", outage_s=0.5)
            await self.call("the loss", lambda: lost(arm))
            with suppress(URError):
                await self.call("recover", arm.recover, 15.0)


class SilentPrimary(Calm):
    """A primary connection that is gone without a word is noticed by its silence, and opened again."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            self.silence(30001)
            await asyncio.sleep(4.0)
            await self.call("make_ready", arm.make_ready)
            await self.call("move_j", lambda: arm.move_j(moved(0.1)))


class UnreadData(Calm):
    """A connection that takes no data, because it is gone without a word, is closed nevertheless."""

    async def use(self) -> None:
        client = PrimaryClient(ROBOT, timeout_s=0.5)
        await client.__aenter__()
        self.silence(30001)
        with pytest.raises(NoAnswerError):
            await client.run(client.core.send_script(f"# {'x' * 1_000_000}\n"))
        await self.call("close", client.close, 1.0)


class LossDuringStop(Calm):
    """`stop` of a motion whose program is lost at that moment returns when the arm rests."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("move_j", lambda: arm.move_j(moved(1.0), speed_rad_s=1.0, wait=False))
            await asyncio.sleep(0.5)
            self.network.cut_off(next(stream for stream in self.streams if stream.local[0] == ROBOT))
            await arm.driver.next_state()
            with suppress(URError):
                await self.call("stop", arm.stop)
            if not self.robot.at_rest:
                self.problem("stop returned and the arm moves")


class PauseDuringAStream(Calm):
    """A paused program would follow the setpoints that wait for it when it resumes: the stream ends with an error."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            for stream in (self.servo, self.speed):
                await self.call("make_ready", arm.make_ready)
                self.world.call_later(0.2, lambda: self.robot.do("dashboard", line="pause"))
                with pytest.raises(RobotRefused, match="paused"):
                    await stream(arm)
                self.robot.do("dashboard", line="play")
                await asyncio.sleep(0.1)
                if not self.robot.at_rest:
                    self.problem("the arm follows old setpoints")

    async def servo(self, arm: AsyncRobot) -> None:
        async with arm.servo_j() as follow:
            for step in range(200):
                await follow(moved(0.001 * step))

    async def speed(self, arm: AsyncRobot) -> None:
        await arm.speed_j([0.1, 0, 0, 0, 0, 0], 2.0)


class OtherDriversLoss(Calm):
    """The robot's message that a driver is gone reaches all drivers; only the one that is meant starts a program."""

    async def use(self) -> None:
        async with driver(50001) as lost, driver(50011) as other:
            await self.call("start_program", lost.start_program)
            await asyncio.sleep(0.3)
            self.silence_programs()
            await asyncio.sleep(2.5)
            if other.program_running or other.loss_reason or not lost.program.losses:
                self.problem(f"not as it should be: {other.program_running} {other.loss_reason} {lost.program.losses}")


class TakenOver(Calm):
    """A driver whose program another one has replaced knows it, even if the end of its connections was lost."""

    async def use(self) -> None:
        async with driver(50001) as before, driver(50011) as after:
            await self.call("start_program", before.start_program)
            await asyncio.sleep(0.3)
            self.silence_programs()
            await self.call("start_program", after.start_program)
            for _ in range(3):
                if before.program_running or not after.program_running:
                    self.problem(f"two masters, or none: {before.program_running} {after.program_running}")
                await asyncio.sleep(1.5)


class LostResult(Calm):
    """The result of a trajectory gets lost together with its connection: the call ends with an error."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("make_ready", arm.make_ready)
            for stream in self.streams:
                if stream.remote is not None and stream.remote[1] == arm.driver.trajectory.port:
                    self.world.call_later(0.2, partial(self.network.stall, stream, float("inf")))
            with pytest.raises(ProgramEndedError):
                await self.call("move_j", lambda: arm.move_j(moved(0.2)), 10.0)
            await self.call("make_ready", arm.make_ready)
            await asyncio.sleep(5.0)  # the new program owes no result
            if arm.driver.loss_reason or not arm.driver.program_running:
                self.problem(f"the new program has ended, too: {arm.driver.loss_reason}")


class AcceptedTooLate(Calm):
    """A program that has ended before a hanging event loop accepts its connections, which are gone, does not run."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            loop = asyncio.get_running_loop()
            self.world.call_later(0.05, lambda: loop.call_soon_threadsafe(lambda: time.sleep(8.0)))
            self.world.call_later(1.0, self.silence_programs)
            with suppress(URError):
                await self.call("make_ready", arm.make_ready)
            await asyncio.sleep(1.0)
            await self.call("make_ready", arm.make_ready)
            await self.call("move_j", lambda: arm.move_j(moved(0.1)))


class LostEnd(Calm):
    """A program whose end was lost together with its connections does not stay for ever."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("make_ready", arm.make_ready)
            self.robot.do("dashboard", line="pause")
            await asyncio.sleep(0.1)
            self.silence_programs()
            await self.call("make_ready", arm.make_ready, 5.0)
            await self.call("move_j", lambda: arm.move_j(moved(0.1)))


class LostAtOnce(Calm):
    """A program whose connections are gone before its driver's first message does not wait for ever."""

    async def use(self) -> None:
        async with driver(50001) as lost:
            await self.call("start_program", lost.start_program)
            self.silence_programs()
            await asyncio.sleep(7.0)
            if not lost.program.losses or not lost.program_running:
                self.problem("the program was not started again")


class LatePoints(Calm):
    """A trajectory whose points come too late leaves none of them to the next one."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("make_ready", arm.make_ready)
            stream = next(one for one in self.streams if one.remote == (PC, arm.driver.trajectory.port))
            self.network.stall(stream, 2.5)
            with pytest.raises(MotionError):
                await self.call("the sequence", lambda: arm.sequence([points.movej(moved(0.1 * n)) for n in range(30)]))
            await self.call("move_j", lambda: arm.move_j(moved(0.2)))
            if abs(self.robot.snapshot.actual_q[0] - moved(0.2)[0]) > NEAR_RAD:
                self.problem("move_j went to a point of another motion")


class LostPoints(Calm):
    """Points that are lost, together with their result, end a motion with an error, and the next one succeeds."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            for count in (1, 3000):  # these are more than the system takes
                await self.call("make_ready", arm.make_ready)
                stream = next(one for one in self.streams if one.remote == (PC, arm.driver.trajectory.port))
                self.network.stall(stream, float("inf"))
                moves = [points.movej(moved(0.1 * n / count)) for n in range(count)]
                with pytest.raises(ProgramEndedError, match="was lost"):
                    await self.call("the sequence", partial(arm.sequence, moves), 10.0)
                await asyncio.sleep(3.0)  # until the program has ended
                await self.call("move_j", lambda: arm.move_j(moved(0.1)))


class ManyPoints(Calm):
    """The progress of a trajectory with more points than the values of an answer can count."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            begin = points.spline(HOME, [0.0] * 6, 0.0)
            moves = [*[begin] * 2199, points.movej(moved(0.2))]
            await self.call("the sequence", lambda: arm.sequence(moves, wait=False))
            while (await self.call("progress", arm.progress)).point < len(moves) - 1:
                await asyncio.sleep(0.1)
            await self.call("wait_done", arm.wait_done)


class LateNews(Calm):
    """The robot's message about a late setpoint arrives when the next stream has begun, and does not end that one."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            await self.call("make_ready", arm.make_ready)
            for stream in self.streams:
                if stream.remote == (ROBOT, 30001):
                    self.network.stall(stream, 0.8)
            with pytest.raises(LateSetpointError):
                await self.call("servo_j", partial(self.servo, arm, 0.3))
            await self.call("servo_j", partial(self.servo, arm, 0.0))

    async def servo(self, arm: AsyncRobot, pause_s: float) -> None:
        async with arm.servo_j() as follow:
            for _ in range(100):
                await follow(HOME)
                await asyncio.sleep(pause_s)


class LostSetpoints(Calm):
    """A stream whose last setpoints are lost does not succeed, even if the robot reports nothing before its end."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            for port in ("reverse", "commands"):
                await self.call("make_ready", arm.make_ready)
                number = getattr(arm.driver, port).port
                stream = next(one for one in self.streams if one.remote == (PC, number))
                self.world.call_later(0.1, partial(self.network.stall, stream, float("inf")))
                with pytest.raises(ProgramEndedError):
                    await self.call("speed_j", lambda: arm.speed_j([0.1, 0, 0, 0, 0, 0], 0.2), 5.0)
                await asyncio.sleep(3.0)  # until the program has ended


class SilentDuringAProgram(Calm):
    """A program that may take for ever does not take for ever if the robot is gone."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            self.world.call_later(1.0, partial(self.network.cut, float("inf")))
            with pytest.raises(NoAnswerError):
                await self.call("programs.run", lambda: arm.programs.run("sleep(100)"), 10.0)


class LostInputs(Calm):
    """An input that is written into a connection that is gone without a word is not lost without one."""

    async def use(self) -> None:
        wrench = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]
        for write in (
            lambda arm: arm.io.set_int_register(24, 7),
            lambda arm: arm.force.set_external_wrench(wrench),  # a stream, which does not wait for each of them
        ):
            async with AsyncRobot(ROBOT, realtime="off") as arm:
                await self.call("writes", partial(repeated, partial(write, arm)))
                self.network.stall(self.streams[-1], float("inf"))
                with pytest.raises(NoAnswerError):
                    await self.call("writes", partial(repeated, partial(write, arm)), 2.0)
        controller = self.robot.emulator.controller
        inputs = controller.snapshot.input_int_registers[24], list(controller.ft_input.wrench_flange)
        if inputs != (7, wrench):
            self.problem(f"the inputs are {inputs}")


class InterruptedPowerUp(Calm):
    """An arm that is switched off, or whose controller restarts, while it is powered on is not waited for."""

    async def use(self) -> None:
        async with AsyncRobot(ROBOT, realtime="off") as arm:
            restart = partial(self.robot.do, "inject_fault", kind="restart_controller", outage_s=0.5)
            for accident in (partial(self.robot.do, "power_off"), restart):
                self.robot.do("power_off")
                await arm.wait_for(lambda state: state.robot_mode is not RobotMode.RUNNING)
                self.world.call_later(0.5, accident)
                with pytest.raises(URError):
                    await self.call("make_ready", arm.make_ready, 10.0)


class StoppedByUser(Calm):
    """A program that ends is not taken for one that has lost a connection, in whatever order its connections end."""

    async def use(self) -> None:
        self.network.line.jitter_s = 0.02
        errors: list[str] = []
        handler = logging.Handler(logging.ERROR)
        handler.emit = lambda record: errors.append(record.getMessage())  # type: ignore[method-assign]
        logging.getLogger("client").addHandler(handler)
        try:
            async with AsyncRobot(ROBOT, realtime="off") as arm:
                for _ in range(5):
                    await self.call("make_ready", arm.make_ready)
                    self.robot.do("dashboard", line="stop")
                    await arm.driver.reverse.wait_disconnected()
                    await asyncio.sleep(0.2)
        finally:
            logging.getLogger("client").removeHandler(handler)
        if errors:
            self.problem(f"in the log: {errors}")


def driver(first: int) -> URDriver:
    names = ("reverse_port", "sender_port", "trajectory_port", "command_port")
    return URDriver(ROBOT, realtime="off", **{name: first + offset for offset, name in enumerate(names)})


def moved(base_rad: float) -> tuple[float, ...]:
    return (HOME[0] + base_rad, *HOME[1:])


async def lost(arm: AsyncRobot) -> None:
    while True:
        try:
            await arm.driver.next_state()
        except NoAnswerError:
            return


async def repeated(call: Callable[[], Awaitable[None]]) -> None:
    for _ in range(20):
        await call()


async def again(call: Callable[[], Awaitable[None]]) -> None:
    """Until the robot has booted."""
    while True:
        try:
            return await call()
        except URError:
            await asyncio.sleep(0.5)


@each_row(
    "kind",
    [
        RestartDuringUse,
        RestartDuringAStop,
        SilentPrimary,
        UnreadData,
        LossDuringStop,
        PauseDuringAStream,
        OtherDriversLoss,
        TakenOver,
        LostResult,
        LostAtOnce,
        AcceptedTooLate,
        LostEnd,
        LateNews,
        LatePoints,
        LostPoints,
        ManyPoints,
        LostSetpoints,
        SilentDuringAProgram,
        LostInputs,
        InterruptedPowerUp,
        StoppedByUser,
    ],
)
def test_found_by_seeds(kind: type[Scenario]) -> None:
    assert not play(1, kind).problems
