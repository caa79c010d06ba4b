"""One running emulator for the tests: reset between tests, observed through a raw RTDE connection."""

import itertools
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from emulator_process import EmulatorProcess
from raw_rtde import InputWriter, Sample, StateStream
from track import Track

from urproto.compat import Self

# Away from every singularity and limit, tool pointing down, room for 0.1 m in every direction.
START_Q = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)
JOINTS = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")

NORMAL, PROTECTIVE_STOP = 1, 3  # safety modes
PATIENCE_S = 30.0  # under load
LAG_S = 0.1  # between two connections; guess for a loaded machine
GRIPPER_PORT = 63352
RUNNING = 7  # robot mode
STOPPED, PLAYING, PAUSED = 1, 2, 4  # runtime states

_FIELDS = [
    "timestamp",
    "actual_q",
    "target_qd",
    "actual_TCP_pose",
    "target_TCP_speed",
    "robot_mode",
    "safety_mode",
    "runtime_state",
    "target_speed_fraction",
    "output_int_register_20",
    "output_double_register_20",
]
_TIDY = """def tidy():
  set_tcp(p[0, 0, 0, 0, 0, 0])
  set_payload(0.0, [0, 0, 0])
  set_gravity([0, 0, 9.82])
  enable_external_ft_sensor(False)
  i = 0
  while i < 8:
    set_standard_digital_out(i, False)
    i = i + 1
  end
  movej({q}, a=20, v=3)
  write_output_integer_register(20, {token})
end
"""


class Watch(StateStream):
    """Records every period; ``track`` is the motion of the arm since the watch began."""

    def __init__(self, host: str, fields: Sequence[str] = ()) -> None:
        super().__init__(host, [*_FIELDS, *fields])

    @property
    def track(self) -> Track:
        """The motion of the arm until it came to rest."""
        self.settled()
        return Track.of(self.samples)

    def settled(self) -> Sample:
        """The state at rest after a command; connections may lag some periods behind one another."""
        self.wait_for(LAG_S)
        return self.wait_until_still()

    def wait_until_still(self, timeout_s: float = PATIENCE_S) -> Sample:
        return self.wait_until(lambda sample: not any(sample["target_qd"]), timeout_s)

    def wait_until_moving(self, timeout_s: float = PATIENCE_S) -> Sample:
        return self.wait_until(lambda sample: any(sample["target_qd"]), timeout_s)


@contextmanager
def disconnecting(*interfaces: "Interface") -> Iterator[None]:
    """Always close ur_rtde's connections: threads left behind would end the whole process."""
    try:
        yield
    finally:
        for interface in interfaces:
            interface.disconnect()


class Interface(Protocol):
    def disconnect(self) -> None: ...


@dataclass
class Rig:
    process: EmulatorProcess
    model: str
    polyscope: tuple[int, int]
    period_s: float
    _tokens: "itertools.count[int]" = field(default_factory=lambda: itertools.count(1))

    @property
    def host(self) -> str:
        return self.process.host

    def start(self) -> Self:
        self.process.start()
        return self

    def watch(self, *fields: str) -> Watch:
        return Watch(self.host, fields)

    def eventually(self, condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
        """Check once per control period until the condition holds."""
        with self.watch() as state:
            state.wait_until(lambda _: condition(), timeout_s)

    def gripper_position(self) -> int:
        """Position of the Robotiq gripper, 0 (open) to 255."""
        with socket.create_connection((self.host, GRIPPER_PORT), timeout=5) as connection:
            connection.sendall(b"GET POS\n")
            return int(connection.makefile().readline().removeprefix("POS "))

    def reset(self) -> None:
        """Powered on, nothing running, full speed, no tool, no payload, arm at START_Q."""
        self.process.dashboard("stop", "close popup", "close safety popup")
        with self.watch() as state:
            self._recover(state)
            with InputWriter(self.host, "speed_slider_mask", "speed_slider_fraction") as slider:
                slider.write(1, 1.0)
                state.wait_until(lambda sample: sample["target_speed_fraction"] == 1.0)
            token = next(self._tokens)
            self.process.send_script(_TIDY.format(q=list(START_Q), token=token))
            state.wait_until(lambda sample: sample["output_int_register_20"] == token)
            state.wait_until(lambda sample: sample["runtime_state"] == STOPPED)

    def _recover(self, state: Watch) -> None:
        if state.newest()["safety_mode"] == PROTECTIVE_STOP:
            self.process.send_script("set unlock protective stop\n")
            state.wait_until(lambda sample: sample["safety_mode"] == NORMAL)
        if state.newest()["robot_mode"] != RUNNING:
            self.process.dashboard("power on", "brake release")
            state.wait_until(lambda sample: sample["robot_mode"] == RUNNING, timeout_s=PATIENCE_S)
        self.process.dashboard("stop")
