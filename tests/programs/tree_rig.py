"""Small program trees, written as PolyScope saves them, and a running arm to play them on."""

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from emulator.commands.requests import DashboardLine
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.networks import MemorySockets
from urproto.modes import RuntimeState
from urproto.primary.messages import RobotMessage, RuntimeExceptionMessage, TextMessage
from urproto.robots import load_model

HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)
BASE = '<feature class="GeomFeatureReference" referencedName="Joint_0_name"/>'
TOOL = '<feature class="GeomFeatureReference" referencedName="Joint_6_name"/>'


def tag(element: str, /, *content: str, **attributes: Any) -> str:
    """An XML element; an attribute called class_ is class."""
    shown = "".join(f" {key.rstrip('_')}={quoteattr(str(value))}" for key, value in attributes.items())
    return f"<{element}{shown}>{''.join(content)}</{element}>"


def children(*nodes: str) -> str:
    return tag("children", *nodes)


def expression(text: str) -> str:
    """One element per character, as the expression editor stores it."""
    return tag("expression", *(tag("ExpressionChar", character=letter) for letter in text))


def line(text: str) -> str:
    """A Script node with a line."""
    return tag("Script", expression(text), type="Line")


def textmsg(text: str) -> str:
    return line(f'textmsg("{text}")')


def sleep(seconds: float) -> str:
    return tag("Wait", tag("waitTime", str(seconds)), type="Sleep")


def assign(name: str, value: str) -> str:
    return tag("Assignment", tag("variable", name=name), expression(value), valueSource="Expression")


def pin(name: str) -> str:
    return tag("pin", referencedName=name)


def main(*nodes: str, once: bool = True, init: bool = False) -> str:
    return tag("MainProgram", children(*nodes), runOnlyOnce=str(once).lower(), InitVariablesNode=str(init).lower())


def waypoint(q: tuple[float, ...], name: str = "Waypoint_1", feature: str = "0, 0, 0, 0, 0, 0", **motion: Any) -> str:
    """A waypoint taught by joint angles, on a UR5e with nominal dimensions."""
    arm = tag(
        "Kinematics",
        tag("deltaTheta", value="0, 0, 0, 0, 0, 0"),
        tag("a", value="0.0, -0.425, -0.3922, 0.0, 0.0, 0.0"),
        tag("d", value="0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996"),
        tag("alpha", value="1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0"),
        status="LINEARIZED",
    )
    angles = tag("JointAngles", angles=", ".join(map(str, q)))
    return tag(
        "Waypoint",
        tag("motionParameters", **motion),
        tag("position", angles, tag("TCPOffset", pose="0, 0, 0, 0, 0, 0"), arm),
        tag("BaseToFeature", pose=feature),
        type="Fixed",
        name=name,
    )


def move(*nodes: str, kind: str = "MoveJ", feature: str = BASE, tcp: str = "", **attributes: Any) -> str:
    speeds = {"speed": 1.05, "acceleration": 1.4} if kind == "MoveJ" else {"speed": 0.25, "acceleration": 1.2}
    shown = {"motionType": kind, "useActiveTCP": str(not tcp).lower(), "positionType": "CartesianPose", **speeds}
    return tag("Move", tcp, feature, children(*nodes), **{**shown, **attributes})


def installation(*extra: str, tcps: str = '<tcp name="TCP" offset="0, 0, 0, 0, 0, 0"/>', active: str = "TCP") -> str:
    return tag("Installation", tag("TCPSettings", tag("availablePoses", tcps), activePose=active), *extra)


def urp(*roots: str, **attributes: Any) -> bytes:
    """A program file: its main program, and threads, subprograms and so on."""
    return gzip.compress(tag("URProgram", children(*roots), **attributes).encode(), mtime=0)


class Arm:
    """An arm with a programs folder, in virtual time; a running UR5e by default."""

    patience_s = 30.0  # of `until`

    def __init__(self, folder: Path, model: str = "ur5e", *, running: bool = True, **config: Any) -> None:
        self.folder = folder
        self.controller = Controller(
            ControllerConfig(model=load_model(model), running=running, programs_dir=folder, initial_q=HOME, **config)
        )
        self.controller.programs.socket_backend = MemorySockets(("10.0.0.1", 50001))
        self.messages: list[RobotMessage] = []
        self.tick()

    @property
    def state(self) -> RuntimeState:
        return self.controller.programs.state

    @property
    def texts(self) -> list[str]:
        return [message.text for message in self.messages if isinstance(message, TextMessage)]

    @property
    def pose(self) -> tuple[float, ...]:
        return self.controller.snapshot.actual_TCP_pose

    @property
    def q(self) -> tuple[float, ...]:
        return self.controller.snapshot.actual_q

    def tick(self) -> None:
        self.controller.tick()
        self.messages += self.controller.new_messages

    def seconds(self, duration: float) -> None:
        for _ in range(round(duration / self.controller.period_s)):
            self.tick()

    def until(self, condition: Callable[[], Any], limit_s: float | None = None) -> float:
        limit_s = self.patience_s if limit_s is None else limit_s
        for count in range(round(limit_s / self.controller.period_s)):
            if condition():
                return count * self.controller.period_s
            self.tick()
        raise AssertionError(f"not reached within {limit_s} s; {self.state.name}, said {self.messages}")

    def request(self, command: str) -> str:
        answers: list[str] = []
        self.controller.post(DashboardLine(command), answers.append)
        self.until(lambda: answers)
        return answers[0]

    def save(self, name: str, *roots: str, **attributes: Any) -> None:
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_bytes(urp(*roots, **attributes))

    def start(self, *roots: str, **attributes: Any) -> None:
        """Save the tree, load and play it."""
        self.save("tree.urp", *roots, **attributes)
        assert self.request("load tree.urp").startswith("Loading program: /programs/tree.urp"), self.texts
        assert self.request("play") == "Starting program", self.messages

    def play(self, *nodes: str, others: tuple[str, ...] = (), **attributes: Any) -> float:
        """Play the nodes as a robot program that runs once, to its end; how long that took [s]."""
        self.start(main(*nodes), *others, **attributes)
        took = self.until(lambda: self.state is RuntimeState.STOPPED)
        failed = [message for message in self.messages if isinstance(message, RuntimeExceptionMessage)]
        assert not failed
        return took
