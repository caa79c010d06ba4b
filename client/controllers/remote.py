"""Client for a controller manager that runs in another process.

async with RemoteManager("192.168.1.10") as manager:
    await manager.request("switch_controller", activate=["forward_velocity_controller"], deactivate=[SCALED])

`client.controllers.session.Session` lists the requests.
"""

import asyncio
import json
import sys
from pathlib import Path
from typing import Any, Final

from client.controllers import protocol
from client.errors import ManagerError, NoManagerError
from urproto.compat import Self
from urproto.compat_asyncio import timeout
from urproto.ports import CONTROLLER_PORTS

ANSWER_S: Final = 10.0  # guess: a running manager answers within milliseconds
_CONNECT_S: Final = 5.0

_LOST: Final = "the controller manager of {} has ended: start it again with `ur-client controllers serve`"


class RemoteManager:
    """Connection to the manager of the robot at an address; use it with ``async with``, which raises NoManagerError.

    rtde_port: the robot's RTDE port, which distinguishes robots at the same address. pid: process id of the manager.
    Requests are carried out one after the other. When the connection ends, everything that was started over it ends:
    goals are canceled, speeds are set to zero, recordings are closed.
    """

    def __init__(self, robot_ip: str, rtde_port: int = CONTROLLER_PORTS["rtde"]) -> None:
        self.robot_ip = robot_ip
        self.pid = 0
        self._rtde_port = rtde_port
        self._count = 0
        self._asking = asyncio.Lock()
        self._reader: asyncio.StreamReader
        self._writer: asyncio.StreamWriter

    async def __aenter__(self) -> Self:
        token = await self._open()
        try:
            self._writer.write(protocol.encoded({"protocol": protocol.VERSION, "token": token}))
            hello = await self._next(_CONNECT_S)
            if "error" in hello:
                raise protocol.error_of(hello["error"])
            self.pid = hello.get("pid", 0)
        except BaseException:
            self._writer.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        self._writer.close()

    async def _open(self) -> str:
        """Connect, and return the required token."""
        place = protocol.rendezvous_path(self.robot_ip, self._rtde_port)
        limit = protocol.MAX_ANSWER
        try:
            async with timeout(_CONNECT_S):
                if sys.platform != "win32" and protocol.HAS_UNIX_SOCKETS:
                    path = place.with_name(f"{place.name}.sock")
                    self._reader, self._writer = await asyncio.open_unix_connection(str(path), limit=limit)
                    return ""
                port, token = _read_port(place.with_name(f"{place.name}.json"))
                self._reader, self._writer = await asyncio.open_connection("127.0.0.1", port, limit=limit)
                return token
        except (FileNotFoundError, ConnectionRefusedError):  # the latter if the manager was killed
            raise NoManagerError(self.robot_ip) from None
        except (OSError, TimeoutError) as error:
            reason = error.strerror if isinstance(error, OSError) and error.strerror else "it does not answer"
            raise ManagerError(f"no connection to the controller manager of {self.robot_ip}: {reason}") from None

    async def request(self, do: str, /, *, timeout_s: float = ANSWER_S, **arguments: Any) -> Any:
        """Send a request and return its answer.

        Raises ControllerError and GoalRejectedError as the manager did, and ManagerError for all other errors.
        """
        async with self._asking:
            self._count += 1
            line = protocol.encoded({"id": self._count, "do": do, **arguments})
            if len(line) > protocol.MAX_REQUEST:
                raise ManagerError(f"{do}: the request has {len(line)} bytes, the limit is {protocol.MAX_REQUEST}")
            try:
                self._writer.write(line)
                await self._writer.drain()
            except OSError:
                raise ManagerError(_LOST.format(self.robot_ip)) from None
            while True:  # answers to requests that timed out may still arrive
                answer = await self._next(timeout_s)
                if answer.get("id") == self._count or "id" not in answer:
                    break
        if "error" in answer:
            raise protocol.error_of(answer["error"])
        return answer.get("result")

    async def _next(self, timeout_s: float) -> protocol.Message:
        try:
            async with timeout(timeout_s):
                line = await self._reader.readline()
        except TimeoutError:
            raise ManagerError(
                f"the controller manager of {self.robot_ip} has not answered for {timeout_s:g} s: is it suspended?"
            ) from None
        except (OSError, ValueError):
            line = b""
        if not line.endswith(b"\n"):
            raise ManagerError(_LOST.format(self.robot_ip))
        return protocol.decoded(line)


async def check_no_manager(robot_ip: str, rtde_port: int) -> None:
    """Raise ManagerError while a manager is running; for callers that start their own control program."""
    try:
        async with RemoteManager(robot_ip, rtde_port) as manager:
            raise ManagerError(
                f"a controller manager is running for {robot_ip} (process {manager.pid}), and a robot runs one control "
                "program at a time: end the manager first"
            )
    except NoManagerError:
        return


def _read_port(path: Path) -> tuple[int, str]:
    """Read port and token. Raises FileNotFoundError, also if the file is not that of a manager."""
    try:
        content = json.loads(path.read_text("utf-8"))
        return int(content["port"]), str(content["token"])
    except (ValueError, KeyError, TypeError):
        raise FileNotFoundError(path) from None
