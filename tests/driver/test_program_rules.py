"""When a control program is started, counts as running, is ended and restarted: the rules, without a robot's time.

The robot is a fake link and plain sockets.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from types import SimpleNamespace
from typing import Any

import pytest
from driver_rig import HOST, PATIENCE_S

from client import dashboard
from client.driver import ReverseEndpoint
from client.driver.config import DriverConfig
from client.driver.control_program import GONE_TEXT, LATE_TEXT
from client.driver.keep_alive import KeepAliveThread
from client.driver.program import ProgramSupervisor
from client.errors import LateSetpointError, ProgramNotRunningError, ScriptFailedError
from tests.rows import each_row
from urproto.compat_asyncio import timeout
from urproto.errors import LocalProtocolError, RobotRefused
from urproto.external_control import ControlMode
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.versions import PolyscopeVersion

ENDS = ("trajectory", "commands", "reverse")
STOPPED, STOPPING, PLAYING = RuntimeState.STOPPED, RuntimeState.STOPPING, RuntimeState.PLAYING


async def until(condition: Callable[[], object]) -> None:
    async with timeout(PATIENCE_S):
        while not condition():
            await asyncio.sleep(0.005)


class Shown(dict[str, Any]):
    """A state that the robot took when it was received."""

    def __init__(self, **values: Any) -> None:
        super().__init__(values)
        self.taken_after_s = time.monotonic()


class Link:
    """What a driver knows of its robot, and the robot: it obeys scripts by connecting or disconnecting its program."""

    def __init__(self) -> None:
        self.state = Shown(runtime_state=STOPPED, timestamp=100.0)
        self.version = PolyscopeVersion.parse("5.25.1")
        self.own_address = HOST
        self.robot_mode, self.safety_mode = RobotMode.RUNNING, SafetyMode.NORMAL
        self.standstill = ""
        self.feed = SimpleNamespace(
            standstill=SimpleNamespace(describe=lambda: self.standstill, beat=lambda: None), mark=lambda: 0.0
        )
        self.on_text: list[Any] = []
        self.on_modes: list[Any] = []
        self.on_silence: list[Any] = []
        self.sent: list[str] = []
        self.loaded: str | None = "drive.urp"
        self.dashboard = SimpleNamespace(request=self._request)
        self.error: asyncio.Future[ScriptFailedError] = asyncio.get_running_loop().create_future()
        self.obeys = True
        self.program: Any = None
        self.opened: list[asyncio.StreamWriter] = []
        self.writers: dict[str, asyncio.StreamWriter] = {}
        self.readers: dict[str, asyncio.StreamReader] = {}

    async def clear_errors(self) -> None:
        self.sent.append("clear")

    async def script_error(self) -> ScriptFailedError:
        return await asyncio.shield(self.error)

    async def next_state(self) -> None:
        await asyncio.sleep(0.005)

    async def send_script(self, text: str) -> None:
        self.sent.append("stop" if text == "stop program" else "program")
        if text == "stop program":
            self.disconnect(*self.writers)
        elif self.obeys:
            await self.connect(*ENDS)

    async def _request(self, operation: Any) -> Any:
        self.sent.append(operation.line)
        if operation is dashboard.PLAY and self.obeys:
            await self.connect(*ENDS)
        return self.loaded

    def show(self, state: RuntimeState, later_s: float = 0.0) -> None:
        """The robot's next state."""
        self.state = Shown(runtime_state=state, timestamp=self.state["timestamp"] + later_s)
        for listener in self.on_modes:
            listener(self.state)

    def say(self, text: str) -> None:
        for listener in self.on_text:
            listener(text)

    async def connect(self, *names: str, token: str | None = None) -> None:
        greeting = self.program.control_program().token if token is None else token
        for name in names:
            port = getattr(self.program, name).port
            self.readers[name], self.writers[name] = await asyncio.open_connection(HOST, port)
            self.opened.append(self.writers[name])
            if greeting:
                self.writers[name].write(f"external_control {greeting}\n".encode())

    def disconnect(self, *names: str) -> None:
        for name in names:
            self.writers.pop(name).close()

    async def has_been_ended(self, name: str) -> bool:
        """Wait until the driver has closed a connection."""
        async with timeout(PATIENCE_S):
            with suppress(ConnectionError):
                while await self.readers[name].read(4096):
                    pass
        return True


@asynccontextmanager
async def opened(**options: Any) -> AsyncIterator[tuple[ProgramSupervisor, Link]]:
    ports = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
    link = Link()
    config = DriverConfig(host=HOST, **(ports | {"start_timeout_s": PATIENCE_S, "keep_alive_timeout_s": 5.0} | options))
    async with ProgramSupervisor(config, link) as program:  # type: ignore[arg-type]
        link.program = program
        try:
            yield program, link
        finally:
            for writer in link.opened:
                writer.close()
            await until(lambda: not program.reverse.connected)


async def connected(program: ProgramSupervisor, link: Link) -> None:
    await link.connect(*ENDS)
    await until(lambda: all(getattr(program, name).connected for name in ENDS))


@each_row(
    ("states", "running"),
    [
        ([], True),  # the robot's state may be older than the connection
        ([STOPPED], True),
        ([PLAYING], True),
        ([RuntimeState.PAUSED], True),
        ([PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING], True),
        ([PLAYING, STOPPED], False),
        ([PLAYING, STOPPING], False),
        ([RuntimeState.RESUMING, STOPPED], False),
        ([RuntimeState.PAUSED, STOPPING], False),
    ],
)
async def test_a_program_runs_from_its_connection_to_its_end_by_the_robots_state(
    states: list[RuntimeState], running: bool
) -> None:
    async with opened() as (program, link):
        assert not program.running
        await connected(program, link)
        for state in states:
            link.show(state)
            last = program.running
        assert (last if states else program.running) is running
        await link.connect(*ENDS)  # the next program: its state is not that of the last one
        await until(lambda: program.running)


MOVABLE = (SafetyMode.NORMAL, SafetyMode.REDUCED)


@each_row("safety", SafetyMode)
async def test_a_program_is_started_only_if_the_arm_can_move(safety: SafetyMode) -> None:
    async with opened() as (program, link):
        link.safety_mode = safety
        for robot in (RobotMode.POWER_OFF, RobotMode.IDLE, RobotMode.RUNNING):
            link.robot_mode, link.sent = robot, []
            if safety in MOVABLE and robot is RobotMode.RUNNING:
                await program.start()
                assert link.sent == ["clear", "stop", "program"]
                assert program.running
                continue
            reason = "release the brakes" if safety in MOVABLE else f"its safety mode is {safety.name}"
            with pytest.raises(RobotRefused, match=reason):
                await program.start()
            assert link.sent == []


async def test_a_program_that_runs_is_ended_before_the_next_one_starts() -> None:
    async with opened() as (program, link):
        for sent in (["clear", "stop", "program"], ["stop", "clear", "stop", "program"]):
            link.sent = []
            await program.start()
            assert link.sent == sent
        stopping = asyncio.create_task(program.stop())
        await until(lambda: program.reverse.mode is ControlMode.STOPPED)
        assert not program.running, "it has been told to stop"
        link.disconnect(*ENDS)
        await stopping


@each_row(
    ("named", "loaded", "sent"),
    [
        ("moves.urp", None, ["clear", "load moves.urp", "play"]),
        (None, "drive.urp", ["clear", "get loaded program", "play"]),
        (None, None, None),
    ],
)
async def test_a_program_of_the_pendant(named: str | None, loaded: str | None, sent: list[str] | None) -> None:
    async with opened(headless=False, program=named) as (program, link):
        link.loaded = loaded
        if sent is None:
            with pytest.raises(RobotRefused, match="no program is loaded"):
                await program.start()
            return
        await program.start()
        assert link.sent == sent
        assert program.running


@pytest.mark.parametrize(("headless", "hint"), [(True, "must be able to reach"), (False, "the URCap did not request")])
async def test_a_program_that_does_not_connect(headless: bool, hint: str) -> None:
    async with opened(headless=headless, start_timeout_s=0.05) as (program, link):
        link.obeys = False
        with pytest.raises(ProgramNotRunningError, match=hint):
            await program.start()
        link.error.set_result(ScriptFailedError(1, 1, "no such function"))
        with pytest.raises(ScriptFailedError):
            await program.start()


@each_row("lost", ENDS)
async def test_with_one_connection_the_others_end(lost: str) -> None:
    async with opened() as (program, link):
        await connected(program, link)
        link.disconnect(lost)
        await until(lambda: not program.running)
        if lost == "reverse":
            assert await link.has_been_ended("trajectory")
            assert await link.has_been_ended("commands")


@each_row("missing", [*ENDS[:2], None])
async def test_each_connection_is_expected_within_half_a_second(missing: str | None) -> None:
    async with opened() as (program, link):
        await link.connect("reverse")
        await until(lambda: program.running)
        await link.connect(*(name for name in ENDS[:2] if name != missing))
        if missing is None:
            await asyncio.sleep(0.6)
            assert program.running
        else:
            await until(lambda: not program.running)
            assert program.reverse.mode is ControlMode.STOPPED


async def test_a_robot_that_falls_silent_is_disconnected() -> None:
    async with opened() as (program, link):
        await connected(program, link)
        for listener in link.on_silence:
            listener()
        assert await link.has_been_ended("reverse")
        await until(lambda: not program.running)


@each_row("standstill", ["", "this machine was asleep"])
@each_row(
    ("options", "text", "restarts", "losses"),
    [
        ({}, GONE_TEXT, True, 1),
        ({}, "something else", False, 0),
        ({}, f"{LATE_TEXT}7", False, 0),
        ({"restart": False}, GONE_TEXT, False, 1),
        ({"headless": False}, GONE_TEXT, False, 1),
        ({"watchdog": True}, GONE_TEXT, False, 0),
    ],
)
async def test_a_program_that_has_lost_its_driver(
    options: dict[str, bool], text: str, restarts: bool, losses: int, standstill: str
) -> None:
    """It is restarted once, if this machine was the cause, and not if the caller's watchdog ended it."""
    watchdog = options.pop("watchdog", False) if "watchdog" in (options := dict(options)) else False
    async with opened(**options) as (program, link):
        await program.start()
        link.sent, link.standstill = [], standstill
        if watchdog:
            program.keep_alive.stop_reason = "the watchdog was not kicked"
        link.show(PLAYING)
        link.say(program.control_program().gone_text if text == GONE_TEXT else text)
        link.say("more")
        link.disconnect(*ENDS)
        await until(lambda: not program.reverse.connected)
        link.show(STOPPED)
        if restarts:
            await until(lambda: program.running)
        else:
            await asyncio.sleep(0.05)
        assert link.sent == (["clear", "stop", "program"] if restarts else [])
        assert program.losses == losses
        why = standstill or "by this machine's clock"
        reason = "the watchdog was not kicked" if watchdog else f"too long ({why}" if losses and standstill else why
        assert (reason in program.loss_reason) if losses or watchdog else program.loss_reason == ""
        await program.start()
        assert program.loss_reason == "", "the caller's own program has lost nothing"
        assert program.losses == losses


# a control program without a token: admitted while a program plays that is not this driver's


@each_row(
    ("state", "played_s", "names", "admitted"),
    [
        (PLAYING, 0.3, ENDS, True),
        (PLAYING, 0.1, ENDS, False),  # it may be this driver's, which has not sent its token yet
        (STOPPED, 0.3, ENDS, False),
        (PLAYING, 0.3, ENDS[1:], False),
    ],
)
async def test_a_program_without_a_token(
    state: RuntimeState, played_s: float, names: tuple[str, ...], admitted: bool
) -> None:
    async with opened() as (program, link):
        link.show(state)
        await link.connect(*names, token="")
        link.show(state, played_s)
        if admitted:
            await until(lambda: program.running)
            assert not program.reverse.peer.authenticated
            await link.connect("reverse")
            await until(lambda: program.reverse.peer.authenticated)
        else:
            await asyncio.sleep(0.5)
            assert not program.running


# keeping alive


class Clock:
    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s


class FakeReverse:
    """Counts what the thread asks of it."""

    def __init__(self) -> None:
        self.connected, self.stops, self.kept_s, self.checked = True, 0, list[float](), 0

    def stop(self) -> None:
        self.stops += 1

    def end_late_stream(self) -> None:
        self.checked += 1

    def continue_mode(self, timeout_s: float) -> None:
        self.kept_s.append(timeout_s)


class Keeper:
    """A keep-alive thread whose time stands still between its cycles."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, hang_s: float = 0.0, standstill: str = "") -> None:
        self.clock, self.reverse, self.beats = Clock(), FakeReverse(), 0
        monkeypatch.setattr("client.driver.keep_alive.time", self.clock)
        still: Any = SimpleNamespace(beat=self._beat, describe=lambda: standstill)
        self.thread = KeepAliveThread(self.reverse, 0.001, 2.5, "off", hang_s, still)  # type: ignore[arg-type]

    def _beat(self) -> None:
        self.beats += 1

    async def pass_s(self, seconds: float) -> None:
        """Let time pass, and the thread notice it."""
        self.clock.now_s += seconds
        seen = self.beats + 2
        await until(lambda: self.beats > seen)


KICK = "the watchdog was not kicked for {} s, its timeout is 1 s"
HUNG = "the event loop of this program has hung for 10.1 s"


@pytest.mark.parametrize(
    ("watchdog_s", "hang_s", "silent_s", "standstill", "reason"),
    [
        (0.0, 0.0, 100.0, "", ""),
        (1.0, 0.0, 0.9, "", ""),
        (1.0, 0.0, 1.1, "", KICK.format("1.10")),
        (0.0, 10.0, 9.9, "", ""),
        (0.0, 10.0, 10.1, "", HUNG),
        (0.0, 10.0, 10.1, "it was asleep", "it was asleep"),
        (1.0, 10.0, 10.1, "", KICK.format("10.10")),
    ],
)
async def test_what_ends_a_program(
    monkeypatch: pytest.MonkeyPatch, watchdog_s: float, hang_s: float, silent_s: float, standstill: str, reason: str
) -> None:
    keeper = Keeper(monkeypatch, hang_s, standstill)
    with keeper.thread:
        keeper.thread.watch(watchdog_s)
        await keeper.pass_s(silent_s)
        await keeper.pass_s(0.0)
        assert (keeper.thread.stop_reason, keeper.reverse.stops) == (reason, bool(reason))
        if not reason:
            return
        keeper.thread.stop_reason = ""  # the next program; the watchdog is off until the caller sets it again
        keeper.thread.report_alive()
        await keeper.pass_s(5.0)
        assert keeper.reverse.stops == 1


async def test_kicks_and_cycles_of_the_event_loop_keep_it_alive(monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = Keeper(monkeypatch, hang_s=10.0)
    with keeper.thread:
        keeper.thread.watch(1.0)
        for _ in range(15):
            await keeper.pass_s(0.9)
            keeper.thread.kick()
            keeper.thread.report_alive()
        assert keeper.reverse.stops == 0
        assert keeper.reverse.checked > 0
        assert set(keeper.reverse.kept_s) == {2.5}
        keeper.reverse.connected = False
        await keeper.pass_s(100.0)
        assert (keeper.reverse.stops, keeper.thread.stop_reason) == (0, "")
    for wrong in (-1.0, float("nan")):
        with pytest.raises(LocalProtocolError):
            keeper.thread.watch(wrong)


async def test_a_message_is_sent_once_in_each_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    keeper = Keeper(monkeypatch)
    with keeper.thread:
        for count in range(1, 4):
            await keeper.pass_s(0.0011)
            await keeper.pass_s(0.0)
            assert len(keeper.reverse.kept_s) == count


@pytest.mark.parametrize(
    ("gaps_s", "late", "skipped", "longest_s"),
    [
        ([0.008, 0.008], 0, 0, 0.008),
        ([0.011, 0.008], 0, 0, 0.011),
        ([0.016, 0.008], 0, 1, 0.016),
        ([0.019], 0, 1, 0.019),
        ([0.021], 1, 2, 0.021),
        ([0.096], 1, 11, 0.096),
    ],
)
async def test_late_setpoints(
    monkeypatch: pytest.MonkeyPatch, gaps_s: list[float], late: int, skipped: int, longest_s: float
) -> None:
    """The robot waits 20 ms; a setpoint that comes later is not sent, and reported once."""
    clock = Clock()
    monkeypatch.setattr("client.driver.reverse.time", clock)
    async with ReverseEndpoint(0, HOST) as reverse:
        reverse.period_s = 0.008
        _, writer = await asyncio.open_connection(HOST, reverse.port)
        await reverse.wait_connected()
        q = [0.0] * 6
        reverse.setpoint(ControlMode.SERVOJ, q, 0.02)
        for gap_s in gaps_s:
            clock.now_s += gap_s
            reverse.end_late_stream()
            if late:
                with pytest.raises(LateSetpointError, match=f"for {1000 * gap_s:.0f} ms"):
                    reverse.setpoint(ControlMode.SERVOJ, q, 0.02)
                assert reverse.mode is ControlMode.IDLE
            else:
                reverse.setpoint(ControlMode.SERVOJ, q, 0.02)
        stream = reverse.stream
        assert (stream.sent, stream.late, stream.skipped) == (1 if late else 1 + len(gaps_s), late, skipped)
        assert stream.longest_gap_s == pytest.approx(longest_s)
        reverse.setpoint(ControlMode.SERVOJ, q, 0.02)
        assert reverse.mode is ControlMode.SERVOJ
        assert (reverse.stream is stream) is not bool(late), "a new motion has its own statistics"
        writer.close()
        await reverse.wait_disconnected()
