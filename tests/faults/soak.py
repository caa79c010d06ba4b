"""An emulator in virtual time under random faults and random clients.

    python tests/faults/soak.py --minutes 60 [--model ur3] [--seed 1]

Each minute of robot time ends with all faults cleared and all clients disconnected; then everything has to be as
before: open files, tasks, threads, hooks, every port listening, a client served. Errors in the log always count as
failures.
"""

import argparse
import asyncio
import ctypes
import gc
import logging
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).parent))

from fault_rig import Client, Robot, RTDEClient

from emulator.clock import RealClock
from emulator.servers.rtde import RTDEServer
from urproto.controlapi import BadArguments, NotPossible
from urproto.rtde.codec import RequestProtocol, SetupInputs, SetupOutputs, Start

MAX_CLIENTS: Final = 12
SCRIPTS: Final = (
    "def go():\n  movej([0.3, -1, 1, 0, 0, 0], t=1)\n  movej([0, -1.5, 0.5, 0, 0, 0], t=1)\nend\n",
    "def busy():\n  i = 0\n  while True:\n    i = i + 1\n    sync()\n  end\nend\n",
    "def wrong():\n  sleep(0.1)\n  nothing_there()\nend\n",
    "set_digital_out(1, True)\n",
    'def talk():\n  socket_open("127.0.0.1", 30003)\n  socket_read_binary_integer(20)\n  popup("hello")\nend\n',
    "stopj(2)\n",
)
LINES: Final = (
    "robotmode",
    "power on",
    "brake release",
    "power off",
    "programState",
    "popup hi",
    "close popup",
    "quit",
)
PORTS: Final = ("dashboard", "primary", "secondary", "realtime", "rtde", "modbus", "primary read-only", "", "scripts")


@dataclass
class Soak:
    """One run. ``errors``: errors in the log; ``struck``: how often each kind struck; the rest: after each minute."""

    robot: Robot
    chance: Random
    errors: list[str] = field(default_factory=list)
    struck: Counter[str] = field(default_factory=Counter)
    memory_kB: list[int] = field(default_factory=list)
    objects: list[int] = field(default_factory=list)
    clients: list[Client] = field(default_factory=list)
    connected: int = 0
    received: int = 0
    _seen: dict[int, int] = field(default_factory=dict)

    async def minute(self, seconds: float = 60.0) -> None:
        """A minute of robot time, then a check that everything is as before."""
        periods = round(seconds / self.robot.period_s)
        for _ in range(periods):
            self._act()
            await self.robot.step()
            for client in self.clients:
                if getattr(client, "reads_on", True):
                    self.received += len(client.read())
        await self._settle()

    def _act(self) -> None:
        """Random actions, each at its average rate per second of robot time."""
        period_s = self.robot.period_s
        for rate, act in ((0.7, self._inject), (0.02, self._clear), (2.0, self._connect), (0.4, self._leave)):
            if self.chance.random() < rate * period_s:
                act()
        if self.chance.random() < 5.0 * period_s and self.clients:
            self._send(self.chance.choice(self.clients))
        if self.chance.random() < 0.3 * period_s:
            self._recover()

    # faults

    def _inject(self) -> None:
        kind, arguments = random_fault(self.chance)
        with suppress(BadArguments, NotPossible):  # conflicts with another; refusals are tested elsewhere
            self.robot.control.inject_fault(kind, **arguments)
        self._count()

    def _count(self) -> None:
        for fault in self.robot.control.faults():
            new = fault["strikes"] - self._seen.get(fault["id"], 0)
            self._seen[fault["id"]] = fault["strikes"]
            self.struck[fault["kind"]] += new
            if fault["problem"]:
                self.errors.append(f"{fault['kind']}: {fault['problem']}")

    def _clear(self) -> None:
        self.robot.control.clear_faults()

    def _recover(self) -> None:
        control = self.robot.control
        actions: tuple[Callable[[], object], ...] = (
            control.restart_safety,
            control.release_brakes,
            control.unlock_protective_stop,
        )
        with suppress(NotPossible):
            self.chance.choice(actions)()

    # clients

    def _connect(self) -> None:
        if len(self.clients) >= MAX_CLIENTS:
            return
        port = self.chance.choice(PORTS[:-2])
        source = self.chance.choice(("127.0.0.1", "127.0.0.2"))
        try:
            client: Any = Client(self.robot.emulator.ports[port], source=source)
        except OSError:
            return  # nobody listens
        client.port = port
        client.keeps = False
        client.reads_on = self.chance.random() < 0.85
        self.connected += 1
        self.clients.append(client)
        if port == "rtde":
            self._send(
                client,
                b"".join(r.encode(2) for r in (RequestProtocol(2), SetupOutputs(("timestamp",), 125.0), Start())),
            )

    def _leave(self) -> None:
        if self.clients:
            self.clients.pop(self.chance.randrange(len(self.clients))).close()

    def _send(self, client: Any, data: bytes = b"") -> None:
        try:
            client.send(data or self._request(client.port))
        except OSError:  # reset, or not read any more
            client.close()
            self.clients.remove(client)

    def _request(self, port: str) -> bytes:
        chance = self.chance
        if chance.random() < 0.15:
            return chance.randbytes(chance.randrange(1, 200))
        if port == "dashboard":
            return chance.choice(LINES).encode() + b"\n"
        if port == "rtde":
            names = chance.choice((("input_int_register_24",), ("speed_slider_mask", "speed_slider_fraction")))
            return SetupInputs(names).encode(2)
        if port == "modbus":
            return b"\x00\x01\x00\x00\x00\x06\x00\x03\x00\x80\x00\x01"
        return chance.choice(SCRIPTS).encode()

    # the check that everything is as before

    async def _settle(self) -> None:
        robot, control = self.robot, self.robot.control
        self._count()
        control.clear_faults()
        for client in self.clients:
            client.close()
        self.clients.clear()
        await self._all_ports_listening()
        control.dashboard("stop")
        control.restart_safety()
        await robot.step(30)
        await self._all_clients_gone()
        await self._served()
        self.memory_kB.append(resident_kB())
        self.objects.append(len(gc.get_objects()))

    async def _all_clients_gone(self) -> None:
        """No client is connected any more."""
        servers = self.robot.emulator.servers.values()
        try:
            await self.robot.until(lambda: not any(server.connections for server in servers))
        except AssertionError:
            left = [(server.name, one._stalls, one.undelivered) for server in servers for one in server.connections]
            raise AssertionError(f"connections remain: {left}, errors: {self.errors}") from None

    async def _all_ports_listening(self) -> None:
        """Every port listens again; an outage ends in a control period, and opening ports takes some iterations of the
        loop."""
        for _ in range(50):
            await self.robot.step()
            listening = all(server.listening for server in self.robot.emulator.servers.values())
            if listening and not self.robot.emulator._power.is_off:
                return
            await asyncio.sleep(0.01)
        raise AssertionError("ports stay closed")

    async def _served(self) -> None:
        robot = self.robot
        client: RTDEClient = await robot.stream()
        await robot.step(5)
        assert len(client.data()) == 5, "a client gets every package"
        dashboard = await robot.dashboard()
        assert b"Robotmode" in await robot.request(dashboard, b"robotmode\n")
        for one in (client, dashboard):
            one.close()
            robot.clients.remove(one)
        await robot.step(3)
        await self._all_clients_gone()

    def state(self) -> dict[str, object]:
        """The state that has to be the same after each minute."""
        controller, servers = self.robot.emulator.controller, self.robot.emulator.servers
        rtde = servers["rtde"]
        assert isinstance(rtde, RTDEServer)
        return {
            "threads": threading.active_count(),
            "tasks": len(asyncio.all_tasks()),
            "open files": len(os.listdir("/proc/self/fd")) if sys.platform == "linux" else 0,
            "hooks": [repr(vars(server.hooks)) for server in servers.values()],
            "subscribers": len(controller._subscribers),
            "on_tick": len(controller.on_tick),
            "snapshot_hooks": len(controller.snapshot_hooks),
            "reservations": dict(rtde.host.reservations._owners),
            "fields": (len(rtde.host.outputs), len(rtde.host.inputs), rtde.host.protocols),
            "script hooks": (
                controller.programs.step_hook,
                controller.programs.start_held,
                controller.programs.frames_held,
            ),
        }


def random_fault(chance: Random) -> tuple[str, dict[str, object]]:
    """A kind with suitable arguments, lasting some seconds."""
    number = chance.random()
    of_all: dict[str, dict[str, object]] = {
        "drop_connection": {"how": chance.choice(("reset", "end"))},
        "refuse_connections": {},
        "turn_away": {"probability": 0.5},
        "half_open": {"once": number < 0.5},
        "kick_slow_readers": {"patience_s": number, "buffer_bytes": 4096},
        "restart_port": {"outage_s": number},
        "stall": {"direction": chance.choice(("sent", "received", "both"))},
        "delay": {"delay_s": 0.3 * number, "jitter_s": 0.1, "direction": chance.choice(("sent", "received", "both"))},
        "limit_bandwidth": {"bytes_per_s": 10.0 ** (5 * number + 1)},
        "split": {"direction": chance.choice(("sent", "received", "both"))},
        "coalesce": {"wait_s": 0.01 + number},
        "duplicate": {"probability": 0.3},
        "garble": {"rate": 0.001 + 0.1 * number, "probability": 0.3, "direction": chance.choice(("sent", "both"))},
        "truncate": {"probability": 0.1},
        "pause_rtde": {},
        "skip_rtde": {"probability": 0.2},
        "stale_data": {"port": chance.choice(("rtde", "realtime", "primary"))},
        "rtde_field_not_found": {"field": chance.choice(("timestamp", "actual_q", "input_int_register_24"))},
        "rtde_input_in_use": {"field": chance.choice(("speed_slider_mask", "input_int_register_24"))},
        "old_rtde_protocol": {},
        "lagging_joint": {"joint": chance.randrange(6), "delay_s": number, "stop_above_rad": 0.05},
        "frozen_feedback": {"joint": chance.randrange(6)},
        "encoder_jump": {"joint": chance.randrange(6), "by_rad": number - 0.5},
        "joint_fault": {"joint": chance.randrange(6), "severity": chance.choice(("fault", "violation"))},
        "program_never_starts": {},
        "program_stuck": {},
        "runtime_exception": {"line": chance.randrange(1, 5)},
        "late_ticks": {},
        "clock_drift": {},
        "restart_controller": {"outage_s": number, "boot_s": number},
        "power_loss": {"boot_s": number},
    }
    kind = chance.choice(list(of_all))
    arguments = of_all[kind]
    if kind in ("restart_controller", "power_loss") and chance.random() < 0.5:
        kind, arguments = "drop_connection", {}
    if kind in _OF_PORTS:
        arguments["port"] = chance.choice(PORTS)
    if chance.random() < 0.2 and kind in _OF_CLIENTS:
        arguments["peer"] = "127.0.0.2"
    arguments["seed"] = chance.randrange(1000)
    arguments["lasting"] = 0.05 + 4.0 * chance.random()
    if chance.random() < 0.3:
        arguments["after"] = chance.random()
    return kind, arguments


_OF_CLIENTS: Final = (
    "drop_connection",
    "turn_away",
    "half_open",
    "kick_slow_readers",
    "stall",
    "delay",
    "limit_bandwidth",
    "split",
    "coalesce",
    "duplicate",
    "garble",
    "truncate",
)
_OF_PORTS: Final = (*_OF_CLIENTS, "refuse_connections", "restart_port")


def resident_kB() -> int:
    """Memory of this process without malloc's reserve; 0 if it is not available."""
    gc.collect()
    if hasattr(ctypes.CDLL(None), "malloc_trim"):
        ctypes.CDLL(None).malloc_trim(0)
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((int(line.split()[1]) for line in lines if line.startswith("VmRSS")), 0)


class _Errors(logging.Handler):
    def __init__(self, errors: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._errors = errors

    def emit(self, record: logging.LogRecord) -> None:
        self._errors.append(self.format(record))


async def soak(model: str, minutes: int, seed: int, seconds: float = 60.0, log: Callable[[str], None] = str) -> Soak:
    """Run minutes of robot time. Raises AssertionError if something is not as before."""
    async with Robot(model) as robot:
        robot.emulator.faults.site.rate = RealClock(robot.period_s)  # drives nothing, but late ticks need real time
        run = Soak(robot, Random(seed))
        handler = _Errors(run.errors)
        logging.getLogger().addHandler(handler)
        try:
            await run._settle()
            before = run.state()
            for minute in range(minutes):
                await run.minute(seconds)
                now = run.state()
                different = {name: (before[name], now[name]) for name in now if now[name] != before[name]}
                assert not different, f"minute {minute + 1}: {different}"
                assert not run.errors, f"minute {minute + 1}: {run.errors}"
                log(f"minute {minute + 1}: {run.memory_kB[-1]} kB, {run.objects[-1]} objects, {run.connected} clients")
        finally:
            logging.getLogger().removeHandler(handler)
        return run


def main() -> None:
    """From the command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--model", default="ur3")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    began = time.monotonic()
    run = asyncio.run(soak(options.model, options.minutes, options.seed, log=print))
    print(f"{options.minutes} min of robot time in {time.monotonic() - began:.0f} s")
    print(f"{run.connected} clients, {run.received / 1e6:.1f} MB received")
    print("strikes:", ", ".join(f"{kind} {count}" for kind, count in sorted(run.struck.items())))


if __name__ == "__main__":
    main()
