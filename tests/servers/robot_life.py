"""An eventful life of a robot in virtual time, and the output of its ports.

Run as a program, it writes one port's bytes, for external parsers:

    PYTHONPATH=. python tests/servers/robot_life.py --robot ur5e:5.9 --minutes 60 --port primary > life.bin

Everything follows from the seed. A client of the port reconnects repeatedly, so that a stream contains several
beginnings, each of a complete connection.
"""

import argparse
import random
import sys
import textwrap
from collections.abc import Callable, Generator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.commands.requests import DashboardLine, RTDEInputs
from emulator.controller import Controller
from emulator.lifecycle.runstate import StopCause
from emulator.lifecycle.safety import SafetyEvent
from emulator.machine import ControllerConfig
from tests.commands import PopupAnswer
from urproto.modes import AnalogDomain, RequestedType
from urproto.robots import load_model
from urproto.signals import CONFIGURABLE, STANDARD, TOOL
from urproto.versions import PolyscopeVersion, Series

Episode = Generator[float, None, None]
"""What happens, as a generator of the seconds to wait before the next thing does."""

EPISODES: list[Callable[["Life"], Episode]] = []

_CONNECTION_S = 300.0  # how long a client stays


def episode(function: Callable[["Life"], Episode]) -> Callable[["Life"], Episode]:
    EPISODES.append(function)
    return function


class Life:
    """A controller with the servers of its ports, and one client of one of them.

    ``take()`` returns the bytes sent to the client since the last call, ``happened`` the episodes so far.
    """

    def __init__(self, model: str, version: str, port: str = "primary", seed: int = 1) -> None:
        parsed = PolyscopeVersion.parse(version)
        self.controller = Controller(ControllerConfig(model=load_model(model), version=parsed))
        self.random = random.Random(seed)
        self.happened: list[str] = []
        self._servers = {server.name: server for server in make_servers(self.controller)}
        self._port = port
        self._client = MemoryClient(self._servers[port])
        self._client_since = self.controller.time_s
        self._scripts = MemoryClient(self._servers["secondary"])
        self._received = bytearray()
        self._order: list[Callable[[Life], Episode]] = []
        self._now: Episode = iter(())  # type: ignore[assignment] # nothing yet

    def run(self, seconds: float) -> None:
        """Continue for this time."""
        end = self.controller.time_s + seconds
        while self.controller.time_s < end:
            wait = next(self._now, None)
            if wait is None:
                self._begin()
                continue
            for _ in range(max(1, round(wait / self.controller.period_s))):
                self.controller.tick()
            self._received += self._client.take()
            self._scripts.take()

    def take(self) -> bytes:
        """Bytes sent to the port's client since the last call."""
        received = bytes(self._received)
        self._received.clear()
        return received

    # parts of episodes

    def script(self, text: str) -> None:
        """Send a program or a line like a client."""
        self._scripts.feed(text.encode() + b"\n")

    def program(self, *parts: str) -> None:
        """Send and start a program of these lines or pieces."""
        text = "\n".join(textwrap.dedent(part).strip() for part in parts)
        self.script(f"def life():\n{textwrap.indent(text, '  ')}\nend")

    def dashboard(self, line: str) -> None:
        self.controller.post(DashboardLine(line))

    def inputs(self, **values: object) -> None:
        self.controller.post(RTDEInputs(values))

    def recover(self) -> Episode:
        """Make the arm ready from any state."""
        ends = ("EMERGENCY_STOP_RELEASED", "SAFEGUARD_CLOSED", "NOT_REDUCED", "RESTART")
        for event in ends:
            self.controller.safety_event(SafetyEvent[event])
        self.controller.external_wrench = (0.0,) * 6
        self.dashboard("stop")
        self.dashboard("close popup")
        self.script("set unlock protective stop")
        self.script("set speed 1.0")
        yield 0.5
        if not self.controller.power.running:
            self.dashboard("brake release")
            while not self.controller.power.running:
                yield 0.5

    def _begin(self) -> None:
        if self.controller.time_s - self._client_since > _CONNECTION_S:
            self._client.vanish()
            self._client = MemoryClient(self._servers[self._port])
            self._client_since = self.controller.time_s
        if not self._order:
            self._order = self.random.sample(EPISODES, len(EPISODES))
        chosen = self._order.pop()
        self.happened.append(chosen.__name__)
        self._now = self._lived(chosen)

    def _lived(self, chosen: Callable[["Life"], Episode]) -> Episode:
        yield from self.recover()
        yield from chosen(self)
        yield self.random.uniform(0.1, 3.0)


@episode
def moves(life: Life) -> Episode:
    joints = [[round(life.random.uniform(-1.2, 1.2), 3) for _ in range(6)] for _ in range(3)]
    life.program(
        *(f"movej({q}, a=1.2, v=0.8)" for q in joints), "movel(pose_trans(get_target_tcp_pose(), p[0,0,-0.02,0,0,0]))"
    )
    for _ in range(12):
        life.script(f"set speed {life.random.uniform(0.2, 1.0):.2f}")
        yield 1.0


@episode
def variables(life: Life) -> Episode:
    life.program("""
        global n = 0
        global ratio = 0.5
        global words = "grüß"
        global ready = True
        global place = p[0,0,0,0,0,0]
        global joints = get_actual_joint_positions()
        global items = [1, 2, 3]
        while n < 40:
          n = n + 1
          ratio = ratio * -1.5
          words = str_cat(words, "x")
          ready = not ready
          items[1] = n
          place = get_actual_tcp_pose()
          sleep(0.1)
        end""")
    yield 6.0


@episode
def many_variables(life: Life) -> Episode:
    names = [f"variable_with_a_long_name_{n}" for n in range(120)]
    life.program(*(f"global {name} = {n}" for n, name in enumerate(names)), "sleep(2)")
    yield 3.0


@episode
def threads(life: Life) -> Episode:
    life.program("""
        thread Blink():
          while True:
            set_standard_digital_out(3, not get_standard_digital_out(3))
            sleep(0.2)
          end
        end
        global handle = run Blink()
        $ 1 "Robot Program"
        $ 2 "Wait: 1"
        sleep(1)
        $ 3 "Wait: 2"
        sleep(2)
        kill handle""")
    yield 4.5


@episode
def texts(life: Life) -> Episode:
    life.program(
        'textmsg("now ", 12.5)', 'textmsg("")', 'varmsg("size", [1, 2])', f'textmsg("{"long " * 900}")', "sleep(0.5)"
    )
    life.dashboard("addToLog somebody was here")
    yield 1.5


@episode
def popups(life: Life) -> Episode:
    life.program('popup("look", "Title", False, True)', 'popup("stop", "", True, False, blocking=True)', "sleep(1)")
    yield 2.0
    life.dashboard("close popup")
    yield 2.0
    life.dashboard("popup hello from the dashboard")
    yield 1.0


@episode
def questions(life: Life) -> Episode:
    life.program("""
        global b = request_boolean_from_primary_client("yes?")
        global i = request_integer_from_primary_client("how many?")
        global f = request_float_from_primary_client("how long?")
        global s = request_string_from_primary_client("who?")""")
    answers = {
        RequestedType.BOOLEAN: True,
        RequestedType.INTEGER: 7,
        RequestedType.FLOAT: 0.25,
        RequestedType.STRING: "me",
    }
    for _ in range(8):
        yield 0.5
        for shown in tuple(life.controller.popups.shown):
            if shown.requested_type in answers:
                life.controller.post(PopupAnswer(shown.request_id, answers[shown.requested_type]))


@episode
def cancelled_question(life: Life) -> Episode:
    life.program('global i = request_integer_from_primary_client("how many?")')
    yield 1.0
    life.script("cancel question")
    yield 1.0


@episode
def mistakes(life: Life) -> Episode:
    for lines in (
        ["nowhere()"],
        ["x = "],
        ["global a = [1, 2]", "global b = a[7]"],
        ["movej([0,0,0])"],
        ["y = 1 / 0", "sleep(1)"],
    ):
        life.program(*lines)
        yield 0.7


@episode
def protective_stops(life: Life) -> Episode:
    life.program("while True:", "  movej([0.3,-1.2,0.5,-1,0.2,0])", "  movej([-0.3,-1.2,0.5,-1,0.2,0])", "end")
    yield 2.0
    life.script("sec stop_it():\n  protective_stop()\nend")
    yield 2.0
    life.dashboard("unlock protective stop")
    yield 4.0
    life.dashboard("unlock protective stop")
    yield 0.5
    life.script("resume program")
    yield 1.0
    for code, argument in ((153, 2), (154, 0), (157, 0), (204, 1)):
        life.controller.protective_stop(StopCause(code, argument, ""))
        yield 1.0
        life.script("set unlock protective stop")
        yield 0.3


@episode
def unreachable(life: Life) -> Episode:
    life.program("movel(p[5, 5, 5, 0, 0, 0])")
    yield 2.0


@episode
def safeguards(life: Life) -> Episode:
    life.program("while True:", "  movej([0.3,-1.2,0.5,-1,0.2,0])", "  movej([-0.3,-1.2,0.5,-1,0.2,0])", "end")
    yield 1.5
    life.controller.safety_event(SafetyEvent.SAFEGUARD_OPEN)
    yield 1.5
    life.controller.safety_event(SafetyEvent.SAFEGUARD_CLOSED)
    yield 1.0
    life.controller.safety_event(SafetyEvent.REDUCED)
    yield 1.0
    life.controller.safety_event(SafetyEvent.NOT_REDUCED)
    yield 1.0


@episode
def emergency_stops(life: Life) -> Episode:
    life.program("movej([0.9,-1.2,0.5,-1,0.2,0])")
    yield 0.5
    for event in (SafetyEvent.ROBOT_EMERGENCY_STOP, SafetyEvent.SYSTEM_EMERGENCY_STOP):
        life.controller.safety_event(event)
        yield 1.5
        life.controller.safety_event(SafetyEvent.EMERGENCY_STOP_RELEASED)
        yield 0.5
        life.dashboard("brake release")
        yield 4.0


@episode
def violation_and_fault(life: Life) -> Episode:
    for event in (SafetyEvent.VIOLATION, SafetyEvent.FAULT):
        life.controller.safety_event(event)
        yield 2.0
        life.dashboard("restart safety")
        yield 1.0


@episode
def power_cycle(life: Life) -> Episode:
    life.dashboard("power off")
    yield 2.0
    life.dashboard("power on")
    yield 6.0
    life.dashboard("brake release")
    yield 3.0


@episode
def pause_and_stop(life: Life) -> Episode:
    life.program("global i = 0", "while True:", "  i = i + 1", "  sleep(0.05)", "end")
    for order in ("pause program", "resume program", "pause program", "stop program"):
        yield 1.0
        life.script(order)


@episode
def signals(life: Life) -> Episode:
    own = life.controller.signals
    for _ in range(20):
        for group in (STANDARD, CONFIGURABLE, TOOL):
            own.set_digital_input(group, life.random.randrange(group.count), life.random.random() < 0.5)
        own.analog_inputs[life.random.randrange(2)] = life.random.uniform(0, 10)
        own.tool_analog_inputs[life.random.randrange(2)] = life.random.uniform(0, 10)
        own.analog_input_domains[0] = life.random.choice(list(AnalogDomain))
        life.inputs(
            standard_digital_output_mask=255, standard_digital_output=life.random.randrange(256),
            standard_analog_output_mask=3, standard_analog_output_type=life.random.randrange(4),
            standard_analog_output_0=life.random.random(), standard_analog_output_1=life.random.random(),
        )  # fmt: skip
        yield 0.3


@episode
def tool(life: Life) -> Episode:
    for voltage in (24, 12, 0):
        life.script(f"set_tool_voltage({voltage})")
        yield 0.5
    if life.controller.version.series is Series.E:
        life.program(
            "set_tool_communication(True, 9600, 2, 1, 1.0, 3.0)",
            "set_tool_voltage(24)",
            "set_tool_output_mode(1)",
            "sleep(1)",
        )
        yield 1.5
        life.program(
            "set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)",
            "set_tool_output_mode(0)",
            "set_tool_digital_output_mode(0, 3)",
        )
        yield 0.5


@episode
def loads(life: Life) -> Episode:
    life.program(
        "set_payload(1.5, [0.01, 0.02, 0.05])",
        "set_tcp(p[0, 0, 0.1, 0, 0.5, 0])",
        "set_gravity([0, 1, 9.8])",
        "sleep(1)",
    )
    yield 2.0
    life.program("set_payload(0)", "set_tcp(p[0,0,0,0,0,0])", "set_gravity([0, 0, 9.82])")
    yield 0.5


@episode
def pushed(life: Life) -> Episode:
    life.program(
        "force_mode(p[0.1,0.2,0,0,0,1], [0,0,1,0,0,0], [0,0,10,0,0,0], 2, [0.1,0.1,0.1,0.17,0.17,0.17])",
        "sleep(3)",
        "end_force_mode()",
    )
    yield 1.0
    life.controller.external_wrench = (1.0, -2.0, 8.0, 0.1, 0.0, -0.2)
    yield 1.5
    life.controller.external_wrench = (0.0,) * 6
    yield 1.0


@episode
def freedrive(life: Life) -> Episode:
    life.program("freedrive_mode()", "sleep(2)", "end_freedrive_mode()")
    yield 0.5
    life.controller.external_wrench = (5.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    yield 1.0
    life.controller.external_wrench = (0.0,) * 6
    yield 1.0


@episode
def rest(_: Life) -> Episode:
    yield 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="ur5e:5.22", help="model:version")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument(
        "--port", default="primary", help="primary, secondary, realtime, or one of them and ' read-only'"
    )
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    model, version = chosen.robot.split(":")
    life = Life(model, version, chosen.port, chosen.seed)
    end = life.controller.time_s + 60.0 * chosen.minutes
    while life.controller.time_s < end:
        life.run(10.0)
        sys.stdout.buffer.write(life.take())
    print(f"{chosen.robot}: {len(life.happened)} episodes, {life.controller.time_s - end:.1f} s over", file=sys.stderr)


if __name__ == "__main__":
    main()
