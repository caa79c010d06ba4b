"""Why streamed motions are rough, found in recordings of a controller that servoes to input registers."""

import json
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import NamedTuple

import pytest
from traffic_rig import VirtualTime, agree, ends
from typer.testing import CliRunner

from client.cli import app
from client.errors import RecordingError
from client.traffic.recording import TrafficRecorder, TrafficRecording
from client.traffic.smoothness import Cause, Smoothness, examine
from emulator.commands.requests import RTDEInputs, ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from tests.rows import each_row
from tests.ticking import ticked
from urproto.external_control import ControlMode, ReverseMessage
from urproto.robots import load_model
from urproto.rtde import codec
from urproto.rtde.fields import INPUT_FIELDS, OUTPUT_FIELDS
from urproto.rtde.recipes import Recipe

SERVO = """def servo():
  while True:
    q = [0, 0, 0, 0, 0, 0]
    i = 0
    while i < 6:
      q[i] = read_input_float_register(i)
      i = i + 1
    end
    servoj(q, t=get_steptime(), lookahead_time={lookahead}, gain={gain})
  end
end
"""
OUTPUTS = (
    "timestamp",
    "target_q",
    "actual_q",
    "runtime_state",
    "safety_mode",
    "speed_scaling",
    "target_speed_fraction",
)
REGISTERS = tuple(f"input_double_register_{number}" for number in range(11))
URRTDE = (*REGISTERS, "input_int_register_0")
SERVOJ = 11  # ur_rtde's number of the command
SECONDS, HZ = 4.0, 125
START_Q = (0.2, -1.4, 1.5, -1.7, -1.5, 0.1)

Path_ = Callable[[float], float]


class Sent(NamedTuple):
    """A setpoint of the base joint, relative to its start, and when it is sent."""

    time_s: float
    angle: float


def smooth(t: float) -> float:
    return 0.2 * (1 - math.cos(2 * math.pi * 0.25 * t))


def on_time(path: Path_, hz: float = HZ) -> list[Sent]:
    return [Sent(step / hz, path(step / hz)) for step in range(round(SECONDS * hz))]


def noisy() -> Path_:
    chance = Random(7)
    return lambda t: smooth(t) + chance.gauss(0, 0.004)


def never_in_time() -> list[Sent]:
    return [one for one in on_time(smooth) if not 1.0 <= one.time_s % 2.0 < 1.15]


def held_back(sent: Sequence[Sent]) -> list[Sent]:
    """What was due within a quarter of a second is sent at its end."""
    return [Sent(max(time_s, 1.35) if 1.1 < time_s < 1.35 else time_s, angle) for time_s, angle in sent]


def recorded(
    path: Path,
    sent: Sequence[Sent],
    *,
    lookahead: float = 0.1,
    gain: float = 300,
    names: tuple[str, ...] = URRTDE,
    late: Callable[[float], float] = lambda t: t,
    states: bool = True,
    slider: float = 1.0,
) -> TrafficRecording:
    """The recording of a client that writes setpoints to registers.

    late: when what the robot sends at a time arrives.
    """
    clock = VirtualTime()
    begin_ns = clock.ns
    recorder = TrafficRecorder(path, now_ns=clock)
    controller = Controller(ControllerConfig(model=load_model("ur3"), running=True, initial_q=START_Q))
    client = recorder.connection(*ends(30004))
    outputs, inputs = Recipe.of(OUTPUTS, OUTPUT_FIELDS), Recipe.of(names, INPUT_FIELDS)
    agree(client, OUTPUTS, names)
    pack = codec.output_packer(outputs, 2)
    controller.post(RTDEInputs({"speed_slider_mask": 1, "speed_slider_fraction": slider}))
    controller.post(RTDEInputs(dict(zip(REGISTERS, START_Q, strict=False))))
    controller.post(ScriptUnit(SERVO.format(lookahead=lookahead, gain=gain), "test"))
    for _ in range(10):
        ticked(controller)
    events = [(time_s, 0, b"", angle) for time_s, angle in sent]
    for step in range(round(SECONDS * HZ) + 20):
        now = (step + 0.5) / HZ
        due = [angle for time_s, angle in sent if now - 1 / HZ <= time_s < now]
        for angle in due:
            controller.post(RTDEInputs(dict(zip(REGISTERS, (START_Q[0] + angle, *START_Q[1:]), strict=False))))
        if states:
            events.append((late(now), 1, pack(ticked(controller)), 0.0))
        else:
            ticked(controller)
    for time_s, _, state, angle in sorted(events, key=lambda event: event[:2]):
        clock.ns = begin_ns + round(1e9 * (1 + time_s))
        if state:
            client.data(False, state)
            continue
        q = (START_Q[0] + angle, *START_Q[1:])
        values = dict(zip(REGISTERS, (*q, 0.0, 0.0, 0.008, lookahead, gain), strict=True)) | {
            "input_int_register_0": SERVOJ
        }
        client.data(True, codec.InputData(1, inputs.pack([values[name] for name in names])).encode(2))
    recorder.close()
    return TrafficRecording.read(path)


def texts(found: Smoothness, cause: Cause) -> str:
    return "; ".join(finding.text for finding in found.findings if finding.cause is cause)


def test_a_smooth_stream_has_no_findings_and_the_lag_of_servoj(tmp_path):
    found = examine(recorded(tmp_path / "robot.pcapng", on_time(smooth)))
    (stream,) = found.streams
    assert found.findings == []
    assert found.remarks == ()
    assert stream.source == "ur_rtde, servoJ"
    assert stream.lag_s == pytest.approx(0.3 * 0.1 + 0.7 / math.sqrt(300), abs=0.01)
    assert stream.timing.rate_hz == pytest.approx(125, rel=1e-3)
    assert [form.name for form in stream.forms] == [
        "setpoints, evenly spaced", "setpoints, as sent", "robot's target", "arm",
    ]  # fmt: skip
    assert stream.forms[0].speed_rad_s == pytest.approx(0.2 * 2 * math.pi * 0.25, rel=0.01)
    assert stream.forms[2].rms_mrad < 0.05


def driven(path: Path, hz: float, mode: ControlMode = ControlMode.SERVOJ) -> TrafficRecording:
    """A driver sends setpoints on the reverse interface, of which the robot takes one in each period."""
    clock = VirtualTime()
    begin_ns = clock.ns
    recorder = TrafficRecorder(path, now_ns=clock)
    rtde, reverse = recorder.connection(*ends(30004)), recorder.connection(*ends(50001, 45679))
    names = ("timestamp", "actual_q", "target_q")
    outputs = Recipe.of(names, OUTPUT_FIELDS)
    agree(rtde, names)
    pack = codec.output_packer(outputs, 2)
    sent = [Sent(0.1 + step / hz, smooth(step / hz)) for step in range(round(SECONDS * hz))]
    states = [0.0] * 8 + [one.angle for one in sent]
    for time_s, number in sorted(
        [(one.time_s, number) for number, one in enumerate(sent)]
        + [((step + 0.5) / HZ, -step - 1) for step in range(round(SECONDS * HZ))]
    ):
        clock.ns = begin_ns + round(1e9 * time_s)
        if number >= 0:
            values = (START_Q[0] + sent[number].angle, *START_Q[1:])
            reverse.data(False, ReverseMessage.setpoint(mode, values, 20).encode())
        else:
            q = (START_Q[0] + states[max(0, -number - 5)], *START_Q[1:])
            rtde.data(False, pack(SimpleNamespace(timestamp=time_s, actual_q=q, target_q=q)))
    recorder.close()
    return TrafficRecording.read(path)


def late_for_a_while(t: float) -> float:
    return max(t, 1.35) if 1.1 < t < 1.35 else t


ROUGH = {
    "10 Hz policy": (on_time(lambda t: smooth(int(t * 10) / 10)), {}, Cause.PROGRAM, r"9\.\d new .* 13 times: a stair"),
    "20 Hz": (on_time(smooth, 20), {}, Cause.PROGRAM, "20.0 new setpoints per second are sent: a staircase"),
    "noise": (on_time(noisy()), {}, Cause.PROGRAM, "the setpoints themselves are rough"),
    "high gain": (on_time(noisy()), {"gain": 2000, "lookahead": 0.03}, Cause.CONTROLLER, r"gain 2000 passes [1-9]\d %"),
    "pauses": (never_in_time(), {}, Cause.PROGRAM, "2 times no setpoint was sent for a while: 160 ms at 1.9"),
    "bursts": (held_back(on_time(smooth)), {}, Cause.PROGRAM, "once setpoints were held back.* states were on time"),
    "network": (
        held_back(on_time(smooth)), {"late": late_for_a_while}, Cause.NETWORK, "once setpoints and states came late",
    ),
    "chunks": (
        on_time(lambda t: smooth(t) + 0.1 * (int(t * 2.5) % 2)), {}, Cause.PROGRAM, "they are 50 setpoints apart",
    ),
    "start": (on_time(lambda t: 0.3 + smooth(t)), {}, Cause.PROGRAM, r"0\.30 rad from the arm \(base\): the arm jumps"),
    "slider": (on_time(smooth), {"slider": 0.5}, Cause.CONTROLLER, "the robot runs at 50 % speed"),
    "other registers": (on_time(noisy()), {"names": REGISTERS[:6]}, Cause.PROGRAM, "setpoints themselves are rough"),
}  # fmt: skip
"""Setpoints, options of the recording, and what is found."""


@each_row("name", ROUGH)
def test_what_makes_a_stream_rough_is_found(name: str, tmp_path: Path) -> None:
    sent, options, cause, text = ROUGH[name]
    found = examine(recorded(tmp_path / f"{name}.pcapng", sent, **options))
    assert re.search(text, texts(found, cause)), found.findings


def test_states_that_were_not_recorded_are_a_remark(tmp_path):
    found = examine(recorded(tmp_path / "robot.pcapng", on_time(noisy()), states=False))
    (stream,) = found.streams
    assert "no RTDE states" in found.remarks[0]
    assert len(stream.forms) == 2
    assert stream.lag_s is None


def test_a_backlog_grows(tmp_path):
    """External Control reads one setpoint per period; here the driver sends a tenth more."""
    found = examine(driven(tmp_path / "robot.pcapng", HZ * 1.1))
    assert re.search(r"falls further and further behind .* by \d+ ms more", texts(found, Cause.PROGRAM)), found.findings
    assert found.streams[0].source == "External Control, joint positions"


def test_setpoints_of_other_kinds_have_a_timing_only(tmp_path):
    found = examine(driven(tmp_path / "robot.pcapng", HZ, ControlMode.SPEEDJ))
    (stream,) = found.streams
    assert stream.source == "External Control, joint speeds"
    assert stream.forms == ()
    assert found.findings == []


def test_single_lines_of_script_are_named_for_what_they_are(tmp_path):
    """As many programs based on python-urx do it."""
    clock = VirtualTime()
    recorder = TrafficRecorder(tmp_path / "robot.pcapng", now_ns=clock)
    client = recorder.connection(*ends(30002))
    for _ in range(50):
        clock.ns += 50_000_000
        client.data(True, b"servoj([0,-1.5,1.5,0,0,0], t=0.05)\n")
    recorder.close()
    (finding,) = examine(TrafficRecording.read(recorder.path)).findings
    assert finding.text.startswith("50 servoj were sent to port 30002 one by one: each is a program")


def test_a_recording_without_a_stream_says_where_one_is_looked_for(tmp_path):
    recorder = TrafficRecorder(tmp_path / "robot.pcapng", now_ns=VirtualTime())
    recorder.connection(*ends(29999)).data(False, b"Connected: Universal Robots Dashboard Server\n")
    recorder.close()
    with pytest.raises(RecordingError, match=r"contains no stream of setpoints: .* 50001"):
        examine(TrafficRecording.read(recorder.path))
    with pytest.raises(RecordingError, match="contains no stream"):
        examine(recorded(tmp_path / "five.pcapng", on_time(smooth), names=REGISTERS[:5]))


def test_the_command_prints_findings_and_advice_and_its_exit_status_tells_them(tmp_path):
    recorded(tmp_path / "rough.pcapng", on_time(noisy()))
    recorded(tmp_path / "smooth.pcapng", on_time(smooth))
    rough = CliRunner().invoke(app, ["smoothness", str(tmp_path / "rough.pcapng")])
    assert rough.exit_code == 1
    assert "- program: the setpoints themselves are rough" in rough.stdout
    assert "  Smooth the program's or the policy's output." in rough.stdout
    good = CliRunner().invoke(app, ["smoothness", str(tmp_path / "smooth.pcapng")])
    assert (good.exit_code, good.stdout.splitlines()[-1]) == (0, "Nothing that makes the motion rough.")
    as_json = CliRunner().invoke(app, ["smoothness", "--json", str(tmp_path / "rough.pcapng")])
    assert json.loads(as_json.stdout)["streams"][0]["findings"][0]["cause"] == "PROGRAM"
