"""How punctual the control period is, with and without clients, compared with a bare nanosleep loop.

Three processes run at the same time: the emulator, the clients, and a loop that does nothing
but sleep until the next deadline and look at the clock. What the loop cannot do, nothing can.
The emulator also tells how long the garbage collector held it up.
"""

import asyncio
import ctypes
import gc
import json
import select
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from table import Table

from emulator.app import Emulator
from emulator.clock import ClockStatistics, RealClock
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from emulator.realtime import claim_real_time, freeze_heap
from urproto.robots import load_model
from urproto.rtde.codec import RequestProtocol, RTDEDecoder, SetupOutputs, Start

SECONDS = 60.0
CLIENTS = 5
PROGRAM_EVERY_S = 2.0
PROGRAM_LINES = 400  # of assignments, each program with other ones: none is known from before
NAMES = ("timestamp", "actual_q", "actual_qd", "target_q", "actual_TCP_pose", "robot_mode", "runtime_state")
SHARES = (0.5, 0.99, 0.999, 1.0)
_START_REPLY = 4  # bytes; data follow at once
_ABSOLUTE = 1  # TIMER_ABSTIME of clock_nanosleep(2)


def measure(seconds: float = SECONDS) -> Table:
    """One row for each arm, number of clients, and loop."""
    rows = []
    for model in ("ur3", "ur5e"):
        for clients, programs in ((0, False), (CLIENTS, False), (CLIENTS, True)):
            rows += _run(model, clients, seconds, programs=programs)
    note = (
        f"Lateness of the start of each control period over {seconds:g} s, with RTDE clients at the full rate. A bare "
        "nanosleep loop ran at the same time. Collector: CPU time of the longest garbage collection. "
        f"Programs: another program of {PROGRAM_LINES} lines was sent every {PROGRAM_EVERY_S:g} s."
    )
    columns = ["arm", "rate", "clients", "what", "p50", "p99", "p99.9", "worst", "missed", "collector", "lost"]
    return Table("Control period", note, columns, rows)


def _run(model: str, clients: int, seconds: float, *, programs: bool) -> list[list[str]]:
    period_s = load_model(model).series.period_s
    serve = child("serve", model)
    assert serve.stdout is not None
    ports = json.loads(serve.stdout.readline())
    sleeping = child("sleep", str(period_s), str(seconds))
    lost = _receive(ports, clients, period_s, seconds, programs=programs)
    served, slept = result(serve), result(sleeping)
    head = [model, f"{1 / period_s:.0f} Hz", f"{clients}, programs" if programs else str(clients)]
    return [
        [*head, "emulator", *served, str(lost)],
        [*head, "nanosleep loop", *slept, "", ""],
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


def _receive(ports: Mapping[str, int], clients: int, period_s: float, seconds: float, *, programs: bool) -> int:
    """Packages that did not come, over all clients."""
    received = {connect(ports["rtde"], 1 / period_s): bytearray() for _ in range(clients)}
    until, next_program, count = time.monotonic() + seconds, time.monotonic(), 0
    while (left := until - time.monotonic()) > 0:
        if programs and time.monotonic() >= next_program:
            _send_program(ports["secondary"], count)
            next_program, count = next_program + PROGRAM_EVERY_S, count + 1
        for connection in select.select(list(received), [], [], min(left, PROGRAM_EVERY_S))[0]:
            received[connection] += connection.recv(65536)
    for connection in received:
        connection.close()
    return sum(gaps(bytes(data), period_s) for data in received.values())


def _send_program(port: int, count: int) -> None:
    lines = "".join(f"  x{line} = {line} + {count}\n" for line in range(PROGRAM_LINES))
    with socket.create_connection(("127.0.0.1", port)) as connection:
        connection.sendall(f"def program_{count}():\n{lines}  sleep(1)\nend\n".encode())


def gaps(data: bytes, period_s: float) -> int:
    """Control periods between the first and the last package that sent none."""
    stamps: list[float] = [struct.unpack(">d", package.payload[1:9])[0] for package in RTDEDecoder().feed(data)]
    return round((stamps[-1] - stamps[0]) / period_s) + 1 - len(stamps)


def connect(port: int, frequency_hz: float, host: str = "127.0.0.1", names: tuple[str, ...] = NAMES) -> socket.socket:
    """An RTDE client that streams."""
    connection = socket.create_connection((host, port))
    for request, most in (
        (RequestProtocol(2), 4096),
        (SetupOutputs(names, frequency_hz), 4096),
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
        freeze_heap()
        emulator.clock.statistics = ClockStatistics()
        with _collections() as took_s:
            _say(dict(emulator.ports))
            await ended.wait()
        _say([*_row(emulator.clock.statistics), f"{1000.0 * max(took_s, default=0.0):.2f} ms"])


@contextmanager
def _collections() -> Iterator[list[float]]:
    """CPU time [s] of each garbage collection in the meantime."""
    took_s: list[float] = []
    begun_s = 0.0

    def see(phase: str, _: object) -> None:
        nonlocal begun_s
        if phase == "start":
            begun_s = time.thread_time()
        else:
            took_s.append(time.thread_time() - begun_s)

    gc.callbacks.append(see)
    try:
        yield took_s
    finally:
        gc.callbacks.remove(see)


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
