"""A bridge and those who talk to it by DDS, on loopback and in a domain of their own."""

import asyncio
import json
import os
import socket
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

from driver_rig import HOST, Pair, driver_options

from client.controllers import ControlledRobot, usual_controllers
from client.ros2.bridge import Bridge
from client.ros2.dds import Participant
from client.ros2.domain import read_domain
from emulator.app import Emulator

LOOPBACK = (
    '<General><Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General>"
    '<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>'
)
ENVIRONMENT = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "CYCLONEDDS_URI": LOOPBACK}
SCALED = "scaled_joint_trajectory_controller"
PATIENCE_S = 60.0
_LAST = 99  # UDP ports of those beyond are taken for outgoing connections too
_turns = count(os.getpid())


@contextmanager
def free_domain() -> Iterator[int]:
    """The number of a domain that no other test of this machine uses meanwhile."""
    for _ in range(_LAST):
        number = 1 + next(_turns) % _LAST
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as claim:
            try:
                claim.bind((HOST, 7400 + 250 * number + 249))  # the last port of the domain, which nobody gets
            except OSError:
                continue
            yield number
            return
    raise AssertionError(f"all domains from 1 to {_LAST} are in use")


class Lab(Pair):
    """A robot, its bridge and the domain they are in."""

    arm: ControlledRobot
    bridge: Bridge

    def __init__(self, robot: Emulator, domain: int) -> None:
        self.robot = robot
        self.domain = domain

    def controller(self, name: str) -> Any:
        return self.arm.manager.controller(name)


@asynccontextmanager
async def bridged(
    robot: Emulator, domain: int, *names: str, prefix: str = "", namespace: str = "", switching: bool = True
) -> AsyncIterator[Lab]:
    """The bridge of a robot, with these controllers active."""
    lab = Lab(robot, domain)
    lab.arm = ControlledRobot(HOST, usual_controllers(prefix), prefix=prefix, **driver_options(robot))
    lab.driver = lab.arm.driver
    with Participant(read_domain(ENVIRONMENT, domain)) as participant:
        lab.bridge = Bridge(lab.arm, participant, prefix=prefix, namespace=namespace, switching=switching)
        async with lab.arm, lab.bridge:
            lab.arm.activate(*lab.bridge.broadcasters, *names)
            participant.start()
            yield lab


class Process:
    """A program that answers lines with lines."""

    def __init__(self, process: asyncio.subprocess.Process) -> None:
        self._process = process

    async def line(self, text: str) -> str:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(f"{text}\n".encode())
        async with asyncio.timeout(PATIENCE_S):
            answer = (await self._process.stdout.readline()).decode().rstrip()
        assert answer, f"it ended at {text!r}"
        return answer

    async def end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._process.wait()
        except TimeoutError:
            self._process.kill()
            await self._process.wait()
            raise


@asynccontextmanager
async def process(*words: str) -> AsyncIterator[Process]:
    pipes = {"stdin": asyncio.subprocess.PIPE, "stdout": asyncio.subprocess.PIPE, "limit": 2**20}
    started = Process(await asyncio.create_subprocess_exec(*words, **pipes))
    try:
        yield started
    finally:
        await started.end()


class Cyclone:
    """The participant of ros2_peer.py."""

    def __init__(self, peer: Process) -> None:
        self._peer = peer

    async def ask(self, **request: Any) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(await self._peer.line(json.dumps(request)))
        return answer

    async def hear(self, topic: str, kind: str, *, latched: bool = False) -> dict[str, Any]:
        """The first message that comes."""
        assert await self.ask(hear=topic, type=kind, latched=latched) == {"hears": topic}
        return await self.next(topic)

    async def next(self, topic: str) -> dict[str, Any]:
        answer = await self.ask(next=topic)
        assert answer.get("topic") == topic, answer
        message: dict[str, Any] = answer["message"]
        return message

    async def say(self, topic: str, kind: str, message: dict[str, Any]) -> None:
        assert await self.ask(say=topic, type=kind, message=message) == {"said": topic}


@asynccontextmanager
async def cyclone(domain: int) -> AsyncIterator[Cyclone]:
    """One that has begun."""
    peer = str(Path(__file__).with_name("ros2_peer.py"))
    async with process(
        sys.executable, peer, str(domain), f"<CycloneDDS><Domain>{LOOPBACK}</Domain></CycloneDDS>"
    ) as it:
        yield Cyclone(it)
