"""One robot of a class: its state and picture, its pendant, and the teacher's commands."""

import asyncio
import http.client
import json
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack, closing, suppress
from math import cos, sin
from typing import Any, Final

from emulator.config import EmulatorConfig
from emulator.pendant_process import Pendant
from urproto.addresses import local_address
from urproto.compat_asyncio import timeout
from urproto.controlapi import ControlClient, NoControlError, NotPossible
from urproto.ports import PENDANT_PORT
from urproto.robots import RobotModel
from urproto.robots.shapes import ArmCapsules
from urproto.vectors import Vector3

_TIMEOUT_S: Final = 5.0  # of a robot's answer (guess)
_PENDANT_TIMEOUT_S: Final = 60.0  # guess: twenty that start together share the machine's cores
_REST_TIMEOUT_S: Final = 10.0  # guess: a program brakes the arm within a second
_RETRY_S: Final = 0.1
_FIELDS: Final = ("robot_mode", "safety_mode", "runtime_state", "actual_q")
_NO_PROGRAM: Final = ("null", "<unnamed>")
_FAILURES: Final = ("VIOLATION", "FAULT")
_AZIMUTH_RAD, _ELEVATION_RAD = 0.6, 0.35  # of the direction in which the picture shows the arm
_SCALE: Final = 80.0  # units of the picture in one reach


class ClassRobot:
    """A robot with the ports of its servers. Methods other than ``open_pendant`` wait, so call them in threads.

    name: shown to the class. state: the last result of ``query``.
    """

    def __init__(self, number: int, config: EmulatorConfig, ports: Mapping[str, int]) -> None:
        self.name = f"Robot {number}"
        self.state: Mapping[str, Any] = {}
        self._config = config
        self._ports = ports
        self._draw = picture_of(config.controller.model)
        self._control = self._connect()
        self._initial: Mapping[str, Any] | None = None
        self._key = secrets.token_urlsafe()
        self._pendant_port = PENDANT_PORT + config.port_offset
        self._pendant: Pendant | None = None
        self._pendant_changed = asyncio.Event()

    def describe(self) -> dict[str, Any]:
        """What the page shows of it."""
        title = self._config.controller.model.title
        return {"name": self.name, "host": self._config.host, "model": title, **self.state}

    def query(self) -> None:
        """Query the state, with the picture of the arm and its clients."""
        call = self._control.call
        try:
            if self._initial is None:
                with suppress(NotPossible):  # it is starting
                    self._initial = call("save", {})
            state = call("state", {"names": _FIELDS})
            self.state = {
                "mode": state["robot_mode"],
                "safety": state["safety_mode"],
                "program": _named(call("dashboard", {"line": "programState"}).partition(" ")[2]),
                "runtime": state["runtime_state"],
                "arm": self._draw(state["actual_q"]),
                "clients": self._clients(call("connections", {})),
            }
        except NoControlError:
            self.state = {}

    def stop(self) -> None:
        """Stop its program. Raises NoControlError."""
        with closing(self._connect()) as control:
            control.call("dashboard", {"line": "stop"})

    def reset(self) -> None:
        """Put it into its first state: stopped, without faults and stops. Raises NotPossible, NoControlError."""
        with closing(self._connect()) as control:
            call = control.call
            call("clear_faults", {})
            call("dashboard", {"line": "stop"})
            for popup in call("popups", {}):
                call("answer_popup", {"popup_id": popup["id"]})
            for verb in ("release_emergency_stop", "close_safeguard", "reset_safeguard"):
                call(verb, {})
            safety = call("state", {"names": ("safety_mode",)})["safety_mode"]
            if safety == "PROTECTIVE_STOP":
                call("unlock_protective_stop", {})
            if safety in _FAILURES:
                call("restart_safety", {})
            deadline_s = time.monotonic() + _REST_TIMEOUT_S
            while True:
                try:
                    call("set_simulation", {"on": False})
                    call("restore", {"document": self._initial or {}})
                    break
                except NotPossible:  # the program is being stopped, and the arm brakes
                    if time.monotonic() > deadline_s:
                        raise
                    time.sleep(_RETRY_S)

    async def open_pendant(self, running: AsyncExitStack) -> str:
        """Start the pendant if necessary; return the address that opens it. Raises TimeoutError, RuntimeError."""
        if self._pendant is None:
            changed = self._pendant_changed
            self._pendant = Pendant(self._config, self._ports, self._pendant_port, lambda _: changed.set(), self._key)
            await running.enter_async_context(self._pendant)
        async with timeout(_PENDANT_TIMEOUT_S):
            while (report := self._pendant.report())["state"] != "running":
                if report["state"] == "given up":
                    raise RuntimeError(report["problem"])
                self._pendant_changed.clear()
                await self._pendant_changed.wait()
        return f"http://{self._config.host}:{self._pendant_port}/?key={self._key}"

    def _connect(self) -> ControlClient:
        host = local_address(self._config.host_of("control"))
        return ControlClient(host, self._ports["control"], self._config.control_token, _TIMEOUT_S)

    def _clients(self, connections: Mapping[str, Sequence[str]]) -> list[str]:
        """The address of each client, with the ports that it uses; browsers use the pendant."""
        ports = {address: ["pendant"] for address in self._browsers()}
        for port, peers in connections.items():
            for peer in peers if port != "control" else ():
                used = ports.setdefault(peer.rpartition(":")[0], [])
                if port not in used:
                    used.append(port)
        return [f"{address}: {', '.join(used)}" for address, used in sorted(ports.items())]

    def _browsers(self) -> list[str]:
        if self._pendant is None or self._pendant.report()["state"] != "running":
            return []
        host = local_address(self._config.host)
        pendant = http.client.HTTPConnection(host, self._pendant_port, timeout=_TIMEOUT_S)
        try:
            pendant.request("GET", "/browsers", headers={"Cookie": f"pendant_{self._pendant_port}={self._key}"})
            found: list[str] = json.loads(pendant.getresponse().read())
        except (OSError, http.client.HTTPException, ValueError):  # it is being restarted
            return []
        finally:
            pendant.close()
        return found


def _named(program: str) -> str:
    """The name of the loaded program, "" without one."""
    return "" if program in _NO_PROGRAM else program


def picture_of(model: RobotModel) -> Callable[[Sequence[float]], list[list[int]]]:
    """A function of the joint angles [rad] that draws the arm: x1, y1, x2, y2 and width of each link, farthest first.

    The base is at (0, 0), y points down, and the arm reaches about 80 units far.
    """
    arm, scale = ArmCapsules(model), _SCALE / model.reach_m

    def project(point: Vector3) -> tuple[float, float, float]:
        right = point[0] * cos(_AZIMUTH_RAD) + point[1] * sin(_AZIMUTH_RAD)
        away = point[1] * cos(_AZIMUTH_RAD) - point[0] * sin(_AZIMUTH_RAD)
        up = point[2] * cos(_ELEVATION_RAD) + away * sin(_ELEVATION_RAD)
        return right * scale, -up * scale, away * cos(_ELEVATION_RAD) - point[2] * sin(_ELEVATION_RAD)

    def draw(q_rad: Sequence[float]) -> list[list[int]]:
        links = []
        for (start, end), radius in zip(arm.axes(q_rad), arm.radii, strict=True):
            (x1, y1, depth1), (x2, y2, depth2) = project(start), project(end)
            links.append((depth1 + depth2, [round(value) for value in (x1, y1, x2, y2, 2.0 * radius * scale)]))
        return [line for _, line in sorted(links, reverse=True)]

    return draw
