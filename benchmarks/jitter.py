"""How punctual the control period is, with and without clients, beside a bare nanosleep loop.

Three processes run at the same time: the emulator, the clients, and a loop that does nothing
but sleep until the next deadline and look at the clock. What the loop cannot do, nothing can.
"""

import asyncio
import ctypes
import json
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Sequence

from table import Table

from emulator.app import Emulator
from emulator.clock import ClockStatistics, RealClock
from emulator.config import EmulatorConfig
from emulator.controller import ControllerConfig
from emulator.realtime import claim_real_time
from urproto.robots import load_model
from urproto.rtde.codec import RequestProtocol, RTDEDecoder, SetupOutputs, Start

SECONDS = 60.0
CLIENTS = 5
NAMES = ("timestamp", "actual_q", "actual_qd", "target_q", "actual_TCP_pose", "robot_mode", "runtime_state")
SHARES = (0.5, 0.99, 0.999, 1.0)
_START_REPLY = 4  # bytes; data follow at once
_ABSOLUTE = 1  # TIMER_ABSTIME of clock_nanosleep(2)


def measure(seconds: float = SECONDS) -> Table:
    """One row for each arm, number of clients, and loop."""
    rows = []
    for model in ("ur3", "ur5e"):
        for clients in (0, CLIENTS):
            rows += _run(model, clients, seconds)
    note = (
        f"Lateness of the start of each control period over {seconds:g} s, RTDE clients at the full rate. "
        "Missed: began a whole period late. Lost: packages a client did not get. "
        "The nanosleep loop ran at the same time."
    )
    columns = ["arm", "rate", "clients", "what", "p50", "p99", "p99.9", "worst", "missed", "lost"]
    return Table("Control period", note, columns, rows)


def _run(model: str, clients: int, seconds: float) -> list[list[str]]:
    period_s = load_model(model).series.period_s
    serve = child("serve", model)
    assert serve.stdout is not None
    port = json.loads(serve.stdout.readline())["port"]
    sleeping = child("sleep", str(period_s), str(seconds))
    lost = _receive(port, clients, period_s, seconds)
    served, slept = result(serve), result(sleeping)
    head = [model, f"{1 / period_s:.0f} Hz", str(clients)]
    return [
        [*head, "emulator", *served, str(lost)],
        [*head, "nanosleep loop", *slept, ""],
    ]


def child(*arguments: str) -> "subprocess.Popen[str]":
    """This file in a process of its own, see ``main``."""
    command = [sys.executable, __file__, *arguments]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def result(process: "subprocess.Popen[str]") -> list[str]:
    """End a child and read the row it prints."""
    out, _ = process.communicate()
    row: list[str] = json.loads(out.splitlines()[-1])
    return row


def _receive(port: int, clients: int, period_s: float, seconds: float) -> int:
    """Packages that did not come, over all clients."""
    received = {connect(port, 1 / period_s): bytearray() for _ in range(clients)}
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        for connection in select.select(list(received), [], [], left)[0]:
            received[connection] += connection.recv(65536)
    for connection in received:
        connection.close()
    return sum(gaps(bytes(data), period_s) for data in received.values())


def gaps(data: bytes, period_s: float) -> int:
    """Control periods between the first and the last package that sent none."""
    stamps: list[float] = [struct.unpack(">d", package.payload[1:9])[0] for package in RTDEDecoder().feed(data)]
    return round((stamps[-1] - stamps[0]) / period_s) + 1 - len(stamps)


def connect(port: int, frequency_hz: float, host: str = "127.0.0.1") -> socket.socket:
    """An RTDE client that streams."""
    connection = socket.create_connection((host, port))
    for request, most in (
        (RequestProtocol(2), 4096),
        (SetupOutputs(NAMES, frequency_hz), 4096),
        (Start(), _START_REPLY),
    ):
        connection.sendall(request.encode(2))
        connection.recv(most)
    return connection


def serve(model: str) -> None:
    """The emulator at free ports, until its standard input ends."""
    asyncio.run(_serve(EmulatorConfig(controller=_running(model), ephemeral_ports=True)))


def serve_at(model: str, host: str) -> None:
    """The emulator at the standard ports of an address, until the standard input ends."""
    asyncio.run(_serve(EmulatorConfig(controller=_running(model), host=host)))


def _running(model: str) -> ControllerConfig:
    return ControllerConfig(model=load_model(model), running=True, remote_control=True)


async def _serve(config: EmulatorConfig) -> None:
    emulator = Emulator(config)
    claim_real_time()
    ended = asyncio.Event()
    async with emulator:
        asyncio.get_running_loop().add_reader(sys.stdin, ended.set)
        await asyncio.sleep(0.5)  # the first periods pay for first-time costs
        assert isinstance(emulator.clock, RealClock)
        emulator.clock.statistics = ClockStatistics()
        _say({"port": emulator.ports["rtde"], "ports": emulator.ports})
        await ended.wait()
        _say(_row(emulator.clock.statistics))


def sleep(period_s: float, seconds: float) -> None:
    """The bare loop."""
    claim_real_time()
    libc = ctypes.CDLL(None)
    until = (ctypes.c_long * 2)()
    period_ns = round(period_s * 1e9)
    statistics = ClockStatistics()
    deadline_ns = time.monotonic_ns()
    for _ in range(round(seconds / period_s)):
        deadline_ns += period_ns
        until[0], until[1] = divmod(deadline_ns, 1_000_000_000)
        libc.clock_nanosleep(time.CLOCK_MONOTONIC, _ABSOLUTE, until, None)
        statistics.record(time.monotonic_ns() - deadline_ns, period_ns)
    _say(_row(statistics))


def _row(statistics: ClockStatistics) -> list[str]:
    shares = [f"{statistics.lateness_s(share) * 1e3:.2f} ms" for share in SHARES[:-1]]
    return [*shares, f"{statistics.latest_ns / 1e6:.2f} ms", f"{statistics.missed} of {statistics.ticks}"]


def _say(value: object) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


def main(arguments: Sequence[str]) -> None:
    """Measure, or be one of the measured processes."""
    match arguments:
        case ["serve", model]:
            serve(model)
        case ["sleep", period_s, seconds]:
            sleep(float(period_s), float(seconds))
        case [seconds]:
            sys.stdout.write(measure(float(seconds)).markdown())
        case _:
            sys.stdout.write(measure().markdown())


if __name__ == "__main__":
    main(sys.argv[1:])
