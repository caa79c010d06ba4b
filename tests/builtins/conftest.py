"""A running robot without a network: programs are submitted as text, time is ticked manually."""

from collections.abc import Callable
from typing import Any

import pytest

from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.networks import MemorySockets
from urproto.modes import RuntimeState
from urproto.primary.messages import KeyMessage, RobotMessage, RuntimeExceptionMessage, TextMessage
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

HOME = (0.0, -1.5, 1.5, -1.6, -1.57, 0.0)


class Rig:
    """A controller, its messages, and the duration of programs."""

    def __init__(self, model: str, version: str | None, running: bool = True) -> None:
        self.controller = Controller(
            ControllerConfig(
                model=load_model(model),
                version=PolyscopeVersion.parse(version) if version else None,
                initial_q=HOME,
                running=running,
            )
        )
        self.sockets = MemorySockets(("10.0.0.1", 50001))
        self.controller.programs.socket_backend = self.sockets
        self.messages: list[RobotMessage] = []
        self.tick()

    @property
    def period(self) -> float:
        return self.controller.period_s

    @property
    def state(self) -> RuntimeState:
        return self.controller.programs.state

    @property
    def q(self) -> tuple[float, ...]:
        return self.controller.snapshot.actual_q

    @property
    def texts(self) -> list[str]:
        return [m.text for m in self.messages if isinstance(m, TextMessage)]

    @property
    def keys(self) -> list[tuple[str, str]]:
        return [(m.title, m.text) for m in self.messages if isinstance(m, KeyMessage)]

    @property
    def exceptions(self) -> list[RuntimeExceptionMessage]:
        return [m for m in self.messages if isinstance(m, RuntimeExceptionMessage)]

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.controller.tick()
            self.messages += self.controller.new_messages

    def seconds(self, duration: float) -> None:
        self.tick(round(duration / self.period))

    def until(self, condition: Callable[[], bool], limit_s: float = 20.0) -> float:
        """Tick until the condition holds; the time that took [s]."""
        for count in range(round(limit_s / self.period)):
            if condition():
                return count * self.period
            self.tick()
        raise AssertionError(f"not reached within {limit_s} s; state {self.state.name}, said {self.messages}")

    def start(self, body: str, name: str = "prog") -> None:
        """Submit the body as a program and tick until it runs or has ended."""
        lines = "".join(f"  {line}\n" for line in body.strip().splitlines())
        self.submit(f"def {name}():\n{lines}end\n")

    def submit(self, text: str) -> None:
        self.controller.programs.submit(text)

    def run(self, body: str, limit_s: float = 20.0) -> float:
        """Run a program to its end; the time from its start to its end [s]. Fails when it ends with an error."""
        before = len(self.exceptions)
        took = self.run_any(body, limit_s)
        assert self.exceptions[before:] == []
        return took

    def run_any(self, body: str, limit_s: float = 20.0) -> float:
        """As run, but the program may end with an error."""
        before = len(self.exceptions)
        self.start(body)
        self.until(lambda: self.state is not RuntimeState.STOPPED or len(self.exceptions) > before, 1.0)
        return self.until(lambda: self.state is RuntimeState.STOPPED, limit_s)

    def fault(self, body: str) -> str:
        """Run a program that must end with an error; the error's text."""
        before = len(self.exceptions)
        self.run_any(body)
        assert len(self.exceptions) == before + 1, "the program did not fail"
        return self.exceptions[-1].text

    def value(self, expression: str, *, meanwhile: Callable[[], None] = lambda: None) -> Any:
        """The value of an expression. meanwhile: called once the program has started, before the expression is
        evaluated."""
        before = len(self.exceptions)
        self.start(f"sync()\nsync()\nsync()\nglobal result = {expression}\nsync()\nsync()")
        meanwhile()
        self.until(lambda: "result" in self.controller.programs.variables or len(self.exceptions) > before, 5.0)
        assert self.exceptions[before:] == []
        result = self.controller.programs.variables["result"]
        self.until(lambda: self.state is RuntimeState.STOPPED, 1.0)
        return result


@pytest.fixture
def rig() -> Rig:
    """A UR5e with its brakes released."""
    return Rig("ur5e", None)


@pytest.fixture
def cb3() -> Rig:
    """A UR5 of the CB3 series with its brakes released."""
    return Rig("ur5", None)


@pytest.fixture
def make_rig() -> Callable[..., Rig]:
    """Another model or version."""
    return Rig
