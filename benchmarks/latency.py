"""From a state to what a client makes of it: RTDE state to executed servoj target, in control periods.

The arm stands still. A client takes a state, at once commands a joint target a little off, and
the first state whose target has left the place tells in which period the command was carried
out. Counted in the controller's own time, so a slow clock is not mistaken for a slow client.
A row is one Commander; the arm, the states and the counting are the same for all.

A servo loop of another program is a row too where UR_LATENCY_PEER has its command line, to which the
robot's address is added: see urcl_servo.cpp.
"""

import json
import os
import random
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from jitter import serve_at
from rtde_control import RTDEControlInterface
from table import Table

from client import BlockingRTDEClient
from client.blocking import Blocking
from client.driver import URDriver
from client.driver.reverse import MAX_REAL_TIME_S
from urproto.compat import Self

SAMPLES: Final = 200
OFFSET_RAD: Final = 0.002  # of the last joint: too little to matter, far above rounding
MOVED_RAD: Final = 1e-7
SETTLED_S: Final = 0.25  # servoj has come to rest by then: its lookahead is 0.03 s
GIVE_UP_S: Final = 2.0
PEER: Final = "UR_LATENCY_PEER"

Command = Callable[[Sequence[float]], None]  # six joint angles [rad]; returns as soon as it may


@contextmanager
def ur_rtde(host: str, period_s: float) -> Iterator[Command]:
    """ur_rtde's servoJ, with the arguments of its own servoing example."""
    control = RTDEControlInterface(host)
    try:
        yield lambda q: control.servoJ(list(q), 0.5, 0.5, period_s, 0.03, 300.0)
    finally:
        control.servoStop()
        control.stopScript()
        control.disconnect()


class Servo(URDriver):
    """This project's driver in a servo loop: a target goes out at once, and again with every state."""

    target: Sequence[float] = ()

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        await self.start_program()
        self.target = self.state["actual_q"]
        self.command(self.target)
        self.robot.on_state.append(lambda _: self.command(self.target))
        return self

    def command(self, q_rad: Sequence[float]) -> None:
        self.target = q_rad
        self.servoj(q_rad, MAX_REAL_TIME_S)


class BlockingServo(Blocking[Servo]):
    """Blocking form of `Servo`."""


@contextmanager
def our_driver(host: str, period_s: float) -> Iterator[Command]:
    """`client.URDriver` with the control program of this project."""
    ports = dict.fromkeys(("reverse_port", "sender_port", "trajectory_port", "command_port"), 0)
    with BlockingServo(host, outputs=("actual_q",), **ports) as servo:
        yield servo.command


@contextmanager
def another_driver(host: str, period_s: float) -> Iterator[Command]:
    """The program of UR_LATENCY_PEER, which takes targets line by line."""
    command = [*shlex.split(os.environ[PEER]), host]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
    assert process.stdin is not None
    assert process.stdout is not None
    lines = process.stdin
    try:
        if "ready\n" not in process.stdout:  # reads until it comes
            raise RuntimeError(f"{shlex.join(command)} ended before it was ready")
        yield lambda q: print(*q, file=lines, flush=True)
    finally:
        process.communicate()


# name -> how its client is opened: a context manager that gives the command
COMMANDERS: Final = {"ur_rtde servoJ": ur_rtde, "URDriver servoj": our_driver} | (
    {f"{Path(shlex.split(os.environ[PEER])[0]).name} servoj": another_driver} if os.environ.get(PEER) else {}
)


def measure(samples: int = SAMPLES) -> Table:
    """One row for each arm and client."""
    rows = []
    for number, (model, period_s) in enumerate((("ur3", 0.008), ("ur5e", 0.002)), start=2):
        for name in COMMANDERS:
            periods = sorted(_measure(model, f"127.0.9.{number}", period_s, name, samples))
            shares = [periods[min(len(periods) - 1, int(share * len(periods)))] for share in (0.5, 0.99)]
            rows.append([model, f"{1 / period_s:.0f} Hz", name, *(f"{count:.0f}" for count in (*shares, periods[-1]))])
    note = (
        f"Control periods from the state that triggers a servoj command to the first state that shows it being "
        f"executed; the minimum is 1. {samples} commands to an arm at rest, each sent as soon as a state arrives."
    )
    return Table("Command latency", note, ["arm", "rate", "client", "p50", "p99", "max"], rows)


def _measure(model: str, host: str, period_s: float, name: str, samples: int) -> list[float]:
    with (
        _emulator(model, host),
        COMMANDERS[name](host, period_s) as command,
        BlockingRTDEClient(host, ["timestamp", "target_q"]) as states,
    ):
        home = states.receive()["target_q"]
        return [_once(states, command, home, period_s) for _ in range(samples)]


def _once(states: BlockingRTDEClient, command: Command, home: Sequence[float], period_s: float) -> float:
    state = states.receive()
    until = state["timestamp"] + SETTLED_S + random.uniform(0.0, 0.02)  # no rhythm of ours meets one of the client's
    while state["timestamp"] < until:
        state = states.latest()
    began, at = state["timestamp"], state["target_q"][5]
    side = 1.0 if at <= home[5] else -1.0
    command([*home[:5], home[5] + side * OFFSET_RAD])
    while abs(state["target_q"][5] - at) < MOVED_RAD:
        state = states.receive()
        if state["timestamp"] > began + GIVE_UP_S:
            raise RuntimeError(f"no target was executed within {GIVE_UP_S} s")
    return float(round((state["timestamp"] - began) / period_s))


@contextmanager
def _emulator(model: str, host: str) -> Iterator[None]:
    """An emulator at the standard ports of a loopback address, which is all that ur_rtde knows."""
    command = [sys.executable, __file__, "serve", model, host]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        json.loads(process.stdout.readline())  # it is ready
        yield
    finally:
        process.communicate()  # its standard input ends


def main(arguments: Sequence[str]) -> None:
    """Measure, or be the emulator."""
    match arguments:
        case ["serve", model, host]:
            serve_at(model, host)
        case [samples]:
            sys.stdout.write(measure(int(samples)).markdown())
        case _:
            sys.stdout.write(measure().markdown())


if __name__ == "__main__":
    main(sys.argv[1:])
