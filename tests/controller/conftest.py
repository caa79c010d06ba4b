"""A controller, and helpers to drive it by ticks."""

from collections.abc import Callable
from typing import Any

import pytest

from emulator.commands.requests import DashboardLine, RTDEInputs, ScriptUnit
from emulator.controller import Controller
from emulator.lifecycle.power import PowerTimings
from emulator.machine import ControllerConfig
from emulator.snapshot import Snapshot
from urproto.primary.messages import RobotMessage
from urproto.robots import RobotModel, load_model
from urproto.versions import PolyscopeVersion

QUICK = PowerTimings(joint_boot_s=0.08, power_on_s=0.04, brake_release_s=0.08)


class Rig:
    """A controller with shorthands; ``messages`` contains all its messages so far."""

    def __init__(self, model: str | RobotModel = "ur3", version: str | None = None, **config: Any) -> None:
        config.setdefault("timings", QUICK)
        parsed = PolyscopeVersion.parse(version) if version else None
        arm = load_model(model) if isinstance(model, str) else model
        self.controller = Controller(ControllerConfig(model=arm, version=parsed, **config))
        self.messages: list[RobotMessage] = []

    @property
    def now(self) -> Snapshot:
        return self.controller.snapshot

    def tick(self, count: int = 1) -> Snapshot:
        for _ in range(count):
            self.controller.tick()
            self.messages += self.controller.new_messages
        return self.controller.snapshot

    def seconds(self, seconds: float) -> Snapshot:
        return self.tick(round(seconds / self.controller.period_s))

    def until(self, condition: Callable[[Snapshot], bool], within_s: float = 10.0) -> Snapshot:
        for _ in range(round(within_s / self.controller.period_s)):
            if condition(self.tick()):
                return self.now
        raise AssertionError(f"did not happen within {within_s} s")

    def request(self, line: str, within_s: float = 10.0) -> str:
        """The dashboard's answer to a line."""
        answers: list[Any] = []
        self.controller.post(DashboardLine(line), answers.append)
        self.until(lambda _: bool(answers), within_s)
        assert len(answers) == 1
        return answers[0]

    def script(self, text: str) -> None:
        kind = "block" if text.lstrip().startswith(("def", "sec")) else "line"
        self.controller.post(ScriptUnit(text, kind))

    def rtde(self, **values: Any) -> Snapshot:
        self.controller.post(RTDEInputs(values))
        return self.tick()

    def messages_of(self, kind: type) -> list[Any]:
        return [message for message in self.messages if isinstance(message, kind)]


@pytest.fixture
def make() -> type[Rig]:
    return Rig


@pytest.fixture
def rig() -> Rig:
    """A UR3 that is off."""
    return Rig()


@pytest.fixture
def ready() -> Rig:
    """A UR3 with its brakes released."""
    return Rig(running=True)
