"""The trace of a run shows what happened: eight planted failures, recordings, hostile files, the size of pages."""

import base64
import json
import math
import re
import struct
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from journal_rig import Recorded
from typer.testing import CliRunner

from client.recording.files import Recorder
from emulator.cli import app
from emulator.commands.requests import DashboardLine, RTDEInputs
from emulator.journal.trace import trace_of
from tests.networks import MemorySockets
from tests.rows import each_row
from urproto.trace.model import Trace, TraceError
from urproto.trace.page import packed, run_in, write_page


def traced(run, tmp_path, **times) -> Trace:
    journal = tmp_path / "run.journal"
    journal.write_bytes(run.journal)
    trace, difference = trace_of(journal, **times)
    assert not difference
    return trace


def texts(trace, lane):
    return [entry.text for entry in trace.lanes[lane].entries] if lane in trace.lanes else []


def entry(trace, lane, pattern):
    """The first entry of a lane in which a pattern occurs."""
    found = [one for one in trace.lanes[lane].entries if re.search(pattern, one.text)]
    assert found, f"{lane} has no {pattern}: {texts(trace, lane)}"
    return found[0]


def state_at(trace, lane, time_s):
    return [one for one in trace.lanes[lane].entries if one.time_s <= time_s][-1].text


def column(trace, name, part, time_s):
    row = next(i for i, sample_s in enumerate(trace.times) if sample_s >= time_s - 1e-6)
    return trace.columns[name][part][row]


class Failure(NamedTuple):
    program: str
    act: Any
    shows: Any
    prepare: Any = lambda robot: None


def runaway_target(trace):
    """The stop, its fault, the line that asked for it, and a target that left its arm behind."""
    stop = entry(trace, "Safety mode", "PROTECTIVE_STOP")
    assert stop.level == "error"
    fault = entry(trace, "Faults", r"^C150A0 joint 0 is at its position limit")
    assert abs(fault.time_s - stop.time_s) < 0.01
    assert "servoj" in state_at(trace, "Program line", stop.time_s)
    speeds = [abs(trace.columns["target_qd"][0][i]) for i, time_s in enumerate(trace.times) if time_s <= stop.time_s]
    assert max(speeds) > 3.0


def wrong_tcp(trace):
    """The tool is 0.3 m longer from this line on: the TCP jumps while the joints rest."""
    tcp = entry(trace, "Setup", r"^TCP: \[0, 0, 0\.3,")
    jump = column(trace, "actual_TCP_pose", 2, tcp.time_s + 0.02) - column(
        trace, "actual_TCP_pose", 2, tcp.time_s - 0.02
    )
    assert abs(jump) > 0.2
    assert column(trace, "actual_qd", 1, tcp.time_s) == 0.0


def no_wait(trace):
    """The arm leaves with the gripper's output in the same period, not half a second later."""
    grip = entry(trace, "Outputs", "DO0 high")
    leaves = entry(trace, "Program line", "movej.*-1.4")
    assert abs(leaves.time_s - grip.time_s) < 0.01


def silent_peer(trace):
    """The socket is open, nothing is ever received, and the program waits in the line that reads."""
    assert any("socket 0 open" in text for text in texts(trace, "Script sockets"))
    assert not any("received" in text for text in texts(trace, "Script sockets"))
    assert "socket_read_line" in state_at(trace, "Program line", trace.times[-1])
    assert state_at(trace, "Program", trace.times[-1]) == "PLAYING"


def input_never_comes(trace):
    """The program polls DI5; only DI4 ever changes."""
    assert texts(trace, "Inputs") == ["DI4 high"]
    assert entry(trace, "Control API", r"set_digital_input.*index=4")
    assert "get_standard_digital_in(5)" in trace.programs[0].split("\n")[1]
    assert re.match(r"[23]:", state_at(trace, "Program line", trace.times[-1]))


def two_threads(trace):
    """Both threads are in a movement when the program ends with an exception that says so."""
    fault = entry(trace, "Faults", "runtime exception|C\\d+")
    before_s = fault.time_s - 0.01
    assert "movej" in state_at(trace, "Thread other", before_s)
    assert state_at(trace, "Program line", before_s).startswith("6: ")
    assert "thread" in fault.text.lower()


def slider_at_zero(trace):
    """The program plays, the arm stands, and the slider is at 0 %, which came by RTDE."""
    assert state_at(trace, "Speed slider", trace.times[-1]) == "0%"
    assert entry(trace, "RTDE inputs", "speed_slider_fraction = 0.0")
    assert state_at(trace, "Program", trace.times[-1]) == "PLAYING"
    assert all(trace.columns["actual_qd"][joint][-1] == 0.0 for joint in range(6))


def register_race(trace):
    """Two writers of one register take turns."""
    written = [text for text in texts(trace, "RTDE inputs") if "input_int_register_24" in text]
    assert written[:4] == [f"input_int_register_24 = {value}" for value in (1, 2, 1, 2)]


def answers_nothing(robot):
    robot.controller.programs.socket_backend = MemorySockets(("10.0.0.1", 80))


def slider(run):
    run.robot.step(100)
    run.post(RTDEInputs({"speed_slider_mask": 1, "speed_slider_fraction": 0.0}))
    run.robot.step(600)


def race(run):
    for number in range(10):
        run.post(RTDEInputs({"input_int_register_24": 1 + number % 2}))
        run.robot.step(3)


def other_input(run):
    run.robot.step(50)
    run.robot.set_digital_input(4, True)
    run.robot.step(200)


def steps(periods):
    return lambda run: run.robot.step(periods)


FAILURES = {
    "a target that runs away": Failure(
        "def fast():\n  q = get_target_joint_positions()\n"
        "  while True:\n    q[0] = q[0] + 0.1\n    servoj(q)\n  end\nend\n",
        steps(500),
        runaway_target,
    ),
    "a wrong TCP": Failure(
        "def tool():\n  sleep(0.2)\n  set_tcp(p[0, 0, 0.3, 0, 0, 0])\n  sleep(1)\nend\n", steps(300), wrong_tcp
    ),
    "a forgotten wait": Failure(
        "def grip():\n  sleep(0.1)\n  set_standard_digital_out(0, True)\n  movej([0, -1.4, 1.5, -1.7, -1.5, 0])\nend\n",
        steps(300),
        no_wait,
    ),
    "a silent peer": Failure(
        'def ask():\n  socket_open("10.0.0.1", 80)\n  line = socket_read_line(timeout=0)\nend\n',
        steps(600),
        silent_peer,
        answers_nothing,
    ),
    "an input that never comes": Failure(
        "def wait():\n  while not get_standard_digital_in(5):\n    sync()\n  end\nend\n", other_input, input_never_comes
    ),
    "two threads that move": Failure(
        "def both():\n  thread other():\n    movej([0.5, -1.4, 1.5, -1.7, -1.5, 0])\n  end\n  run other()\n"
        "  sleep(0.1)\n  movej([0, -1.4, 1.5, -1.7, -1.5, 0])\nend\n",
        steps(300),
        two_threads,
    ),
    "a speed slider at zero": Failure(
        "def go():\n  movej([0, -1.4, 1.5, -1.7, -1.5, 0])\nend\n", slider, slider_at_zero
    ),
    "a race for a register": Failure("def idle():\n  sleep(1)\nend\n", race, register_race),
}


@each_row("name", FAILURES)
def test_a_trace_shows_the_cause_of(name, tmp_path):
    failure = FAILURES[name]
    run = Recorded(prepare=failure.prepare)
    run.robot.step(5)
    run.robot.send_script(failure.program)
    failure.act(run)
    trace = traced(run, tmp_path)
    assert entry(trace, "Control API", "send_script")
    failure.shows(trace)


def test_a_part_of_a_run(tmp_path):
    run = Recorded("ur3")
    run.robot.step(1000)
    run.post(DashboardLine("stop"))
    run.robot.step(1000)
    begin_s = 42.0
    trace = traced(run, tmp_path, begin_s=begin_s, end_s=begin_s + 2.0)
    assert (trace.times[0], trace.times[-1]) == pytest.approx((begin_s, begin_s + 2.0), abs=0.009)
    assert "Dashboard" not in trace.lanes


def unpacked(run: str) -> tuple[dict[str, Any], dict[str, list[list[float]]]]:
    """What a browser reads: the header and the columns."""
    data = zlib.decompress(base64.b64decode(run))
    (length,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + length])
    count, at = header["samples"], 4 + length

    def column(kind):
        nonlocal at
        planes = [data[at + i * count : at + (i + 1) * count] for i in range(4)]
        at += 4 * count
        sums, total = [], 0
        for parts in zip(*planes, strict=True):
            total = (total + int.from_bytes(bytes(parts), "little")) & 0xFFFFFFFF
            sums.append(total)
        return struct.unpack(f"<{count}{kind}", struct.pack(f"<{count}I", *sums))

    header["ticks"] = column("I")
    return header, {name: [column("f") for _ in range(size)] for name, size in header["columns"].items()}


def test_a_packed_run_has_the_values_of_its_trace():
    trace = Trace("a", "b")
    for number in range(100):
        values = {"actual_q": [math.sin(number), -number, 1e-30, 0.0, math.pi, 1e6], "robot_mode": 7}
        trace.add(10.0 + 0.01 * number, values)
        if number >= 50:
            trace.place("ball", {"sphere": 0.1}, (number, 0.0, 0.0, 0.0, 0.0, 0.0))
    trace.event("Log", 10.5, "caf\udce9 </script><script>alert(1)</script>", "error")
    trace.finish()
    header, columns = unpacked(packed(trace))
    assert columns["actual_q"] == [tuple(part) for part in trace.columns["actual_q"]]
    assert [math.isnan(x) for x in columns["object ball"][0]] == [True] * 50 + [False] * 50
    assert header["start"] + header["ticks"][-1] / 10_000 == pytest.approx(10.99)
    assert header["lanes"][-1]["entries"] == [[10.5, "caf\\xe9 </script><script>alert(1)</script>", "error"]]


def test_a_minute_takes_less_than_5_mb(tmp_path):
    """A dynamic arm, whose noise cannot be compressed, and a client that sends setpoints all the time."""
    run = Recorded("ur5e", arm="dynamic", seed=1)
    run.robot.send_script(
        "def go():\n  while True:\n    movej([0.2, -1.4, 1.5, -1.7, -1.5, 0.3])\n"
        "    movej([0, -1.2, 1, -1.7, -1.5, 0])\n  end\nend\n"
    )
    for number in range(750):
        run.post(RTDEInputs({"input_double_register_24": number / 7.0}))
        run.robot.step(4)
    trace = traced(run, tmp_path)
    write_page(tmp_path / "empty.html", "x", "")
    of_the_page = (tmp_path / "empty.html").stat().st_size
    assert of_the_page + 10 * len(packed(trace)) < 5e6
    assert len(trace.times) == pytest.approx(750, abs=2)


def test_a_recording_of_another_arm(tmp_path):
    """Its arm is recognised by its motion; its states are lanes."""
    run = Recorded("ur10e")
    names = ("timestamp", "actual_q", "target_q", "actual_TCP_pose", "robot_mode", "safety_mode", "runtime_state")
    names += ("actual_digital_output_bits", "script_control_line")
    run.robot.send_script(
        "def go():\n  sleep(0.1)\n  set_tool_digital_out(1, True)\n  movej([0.3, -1.2, 1, -1.7, -1.5, 0])\nend\n"
    )
    mcap = tmp_path / "arm.mcap"
    with Recorder(mcap, names) as recorder:
        for _ in range(400):
            run.robot.step(2)
            recorder.write({name: getattr(run.robot.controller.snapshot, name) for name in names})
    page = tmp_path / "page.html"
    assert called("trace", mcap, "-o", page) == (0, f"{page}: 0.3 MB")
    header, columns = unpacked(run_in(page))
    assert header["about"].startswith("UR10e")
    assert header["samples"] == 200
    lanes = {lane["name"]: [entry[1] for entry in lane["entries"]] for lane in header["lanes"]}
    assert lanes["Outputs"] == ["TO1 high"]
    assert lanes["Program"][0] == "PLAYING"
    assert lanes["Program line"][:2] == ["2", "4"]
    assert columns["actual_q"][0][-1] == pytest.approx(run.robot.controller.snapshot.actual_q[0], abs=0.002)


def called(*words):
    """Exit status and output of a command, which must be one line."""
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.output.count("\n") == 1, done.output
    return done.exit_code, done.output.strip()


def test_a_page_without_its_library_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr("urproto.trace.page.find_spec", lambda name: None)
    with pytest.raises(TraceError, match=r"of the extra pendant: .*\[pendant\]"):
        write_page(tmp_path / "page.html", "x", "")


def damaged_journal(path):
    run = Recorded("ur3")
    run.robot.step(600)
    data = bytearray(run.journal)
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


@each_row(
    ("name", "write", "message"),
    [
        ("gone.journal", lambda path: None, "No such file or directory"),
        ("a.journal", lambda path: path.write_bytes(b"ur-emulator journal 1\n"), "the journal has no beginning"),
        ("b.journal", damaged_journal, "is damaged after"),
        ("c.mcap", lambda path: path.write_bytes(b"\x89MCAP0\r\n" + bytes(100)), "c.mcap"),
        ("d.txt", lambda path: path.write_text("hello"), "d.txt"),
        ("e.html", lambda path: path.write_text("<script id='run'>"), "is not the page of a trace"),
        ("f.html", lambda path: path.write_text('<script id="run" type="text/plain">abcd</script>'), "is not the page"),
    ],
)
def test_other_and_damaged_files_give_one_line(name, write, message, tmp_path):
    file = tmp_path / name
    write(file)
    status, line = called("trace", file, "-o", tmp_path / "page.html")
    assert status == 2
    assert line.startswith("ur-emulator trace: ")
    assert message in line
    assert not Path(tmp_path, "page.html").exists()
