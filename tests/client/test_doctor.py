"""What the doctor makes of what it sees."""

import math
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from typer.testing import CliRunner

from client import dashboard, rtde
from client.cli import app
from client.commands import doctor
from client.doctor import (
    Finding,
    Grade,
    check_stream,
    examine_machine,
    examine_own_ports,
    examine_replies,
    examine_stream,
    exit_status,
    governor,
    preemption,
    priority,
)
from emulator import check
from tests.rows import each_row
from urproto.dashboard import GREETING
from urproto.testing.process import EmulatorProcess

PERIOD_S = 0.002


ANSWERS = {
    "robotmode": "Robotmode: RUNNING",
    "programState": "STOPPED",
    "running": "Program running: false",
    "get loaded program": "No program loaded",
}


@contextmanager
def dashboard_of(answers: Mapping[str, str], pieces: int = 1) -> Iterator[tuple[str, int]]:
    """A dashboard server that gives these answers, each in so many pieces; yields address and port offset."""

    def serve() -> None:
        line, _ = listening.accept()
        with line, suppress(OSError):
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            send(line, answers.get("", GREETING))
            for query in line.makefile():
                send(line, answers.get(query.strip(), f"could not understand: {query.strip()!r}"))

    def send(line: socket.socket, answer: str) -> None:
        data = f"{answer}\n".encode()
        size = -(-len(data) // pieces)
        for start in range(0, len(data), size):
            line.sendall(data[start : start + size])
            time.sleep(0.02 if pieces > 1 else 0.0)

    with socket.create_server(("127.0.0.1", 0)) as listening:
        server = threading.Thread(target=serve)
        server.start()
        yield "127.0.0.1", listening.getsockname()[1] - dashboard.PORT
        server.join()


@each_row(
    ("answers", "pieces", "grade", "text"),
    [
        (ANSWERS, 1, None, ""),
        (ANSWERS, 3, Grade.WEAK, "pieces"),
        (ANSWERS | {"": "Verbunden: Universal Robots Dashboard-Server"}, 1, Grade.BROKEN, "its greeting is 'Verbunden"),
        (ANSWERS | {"robotmode": "Robotermodus: LAUFEND"}, 1, Grade.BROKEN, "clients expect 'Robotmode: '"),
        ({"robotmode": ANSWERS["robotmode"]}, 1, Grade.BROKEN, "does not understand programState, running, get loaded"),
    ],
)
def test_dashboards(answers: Mapping[str, str], pieces: int, grade: Grade | None, text: str) -> None:
    with dashboard_of(answers, pieces) as (host, offset):
        found = {finding.subject: finding for finding in examine_replies(host, offset)}
    assert found["round trip"].grade is Grade.GOOD
    if grade is None:
        assert "dashboard" not in found
    else:
        assert found["dashboard"].grade is grade
        assert text in found["dashboard"].text


@pytest.mark.long
def test_silences_and_held_inputs() -> None:
    """A second driver is refused, and a robot that falls silent every three seconds loses both."""
    with EmulatorProcess(["--running"]) as robot, rtde.BlockingRTDEClient(robot.host, [], [["speed_slider_mask"]]):
        robot.control.inject_fault("pause_rtde", after=1.5, lasting=1.0)
        found = list(examine_stream(robot.host))
        robot.control.inject_fault("pause_rtde", after=1.5, lasting=1.0)
        checked = CliRunner().invoke(check.app, [robot.host, "--watch", "4"])
    assert any(finding.grade is Grade.WEAK and "another client holds" in finding.text for finding in found)
    assert any(finding.grade is Grade.BROKEN and "nothing arrived for 1." in finding.text for finding in found)
    assert checked.exit_code == 1
    assert "it fell silent for 1." in checked.output


def grades(stamps: list[float], arrivals: list[float]) -> dict[str, Finding]:
    return {finding.subject: finding for finding in check_stream(arrivals, stamps)}


def regular(count: int = 500) -> list[float]:
    return [i * PERIOD_S for i in range(count)]


def test_a_regular_stream_is_good() -> None:
    found = grades(regular(), [1000.0 + stamp for stamp in regular()])
    assert found["RTDE stream"].grade is Grade.GOOD
    assert "at 500 Hz" in found["RTDE stream"].text
    assert found["jitter"].grade is Grade.GOOD


def test_late_states_are_jitter() -> None:
    arrivals = [stamp + (0.005 if i % 10 == 0 else 0.0) for i, stamp in enumerate(regular())]
    found = grades(regular(), arrivals)
    assert found["RTDE stream"].grade is Grade.GOOD
    assert found["jitter"].grade is Grade.WEAK
    assert "worst 5.00 ms" in found["jitter"].text
    assert "cable" in found["jitter"].mend


def test_one_late_state_in_a_thousand_is_reported_without_advice() -> None:
    arrivals = regular(1000)
    arrivals[500] += 0.02
    found = grades(regular(1000), arrivals)
    assert found["jitter"].grade is Grade.GOOD
    assert "worst 20.00 ms" in found["jitter"].text


def test_states_that_were_left_out_are_counted() -> None:
    stamps = [stamp for i, stamp in enumerate(regular()) if i not in (50, 51, 200)]
    found = grades(stamps, stamps)
    assert found["RTDE stream"].grade is Grade.WEAK
    assert "3 missing" in found["RTDE stream"].text


@each_row("stamps", [[], [1.0], [1.0, 1.0, 1.0]])
def test_a_clock_that_stands_still(stamps: list[float]) -> None:
    assert grades(stamps, stamps)["RTDE stream"].grade is Grade.BROKEN


def test_kernels(tmp_path: Path) -> None:
    assert preemption("#1 SMP PREEMPT_DYNAMIC Debian", tmp_path).grade is Grade.WEAK
    assert "PREEMPT_DYNAMIC" in preemption("#1 SMP PREEMPT_DYNAMIC Debian", tmp_path).text
    assert "none" in preemption("#1 SMP Debian", tmp_path).text
    assert preemption("#1 SMP PREEMPT_RT Debian", tmp_path).grade is Grade.GOOD
    (tmp_path / "sys/kernel").mkdir(parents=True)
    (tmp_path / "sys/kernel/realtime").write_text("1\n")
    assert preemption("#1 SMP", tmp_path).grade is Grade.GOOD


def test_priorities() -> None:
    assert priority(0, granted=False).grade is Grade.WEAK
    assert "limits.d" in priority(0, granted=False).mend
    assert priority(99, granted=False).grade is Grade.WEAK  # a container without the capability
    assert "SYS_NICE" in priority(-1, granted=False).mend
    assert priority(0, granted=True).grade is Grade.GOOD  # root, or a capability


def test_governors(tmp_path: Path) -> None:
    assert governor(tmp_path).grade is Grade.UNKNOWN
    for number, kind in enumerate(("performance", "powersave")):
        folder = tmp_path / f"sys/devices/system/cpu/cpu{number}/cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(f"{kind}\n")
    assert governor(tmp_path).grade is Grade.WEAK
    assert "1 x powersave" in governor(tmp_path).text
    (tmp_path / "sys/devices/system/cpu/cpu1/cpufreq/scaling_governor").write_text("performance\n")
    assert governor(tmp_path).grade is Grade.GOOD


def test_other_systems_report_which_checks_they_lack(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    found = list(examine_machine())
    assert [finding.grade for finding in found] == [Grade.UNKNOWN] * 3
    assert exit_status(found) == 0


def test_a_port_of_the_driver_that_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        monkeypatch.setattr("client.doctor.REVERSE_PORT", port)
        found = {finding.subject: finding for finding in examine_own_ports()}
    assert found[f"port {port}"].grade is Grade.WEAK
    assert f":{port}" in found[f"port {port}"].mend


def test_exit_status() -> None:
    good, weak, broken = (Finding(grade, "a", "b") for grade in (Grade.GOOD, Grade.WEAK, Grade.BROKEN))
    assert exit_status([]) == exit_status([good, weak]) == 0
    assert exit_status([good, broken]) == 1


@each_row("stamp", [math.nan, math.inf, 1e300])
def test_states_without_a_time_are_a_finding(stamp):
    stamps = [0.002 * number for number in range(100)]
    arrivals = list(stamps)
    stamps[50] = stamp
    (found,) = check_stream(arrivals, stamps)
    assert (found.grade, found.text) == (Grade.BROKEN, "1 of 100 states have no time (timestamp)")


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_what_is_not_text_is_printed_as_escapes(options: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    found = Finding(Grade.UNKNOWN, "round trip", "the robot refused 'robotmode': Robotmo\udce7e")
    monkeypatch.setattr(doctor, "_examine", lambda *_: iter([found]))
    result = CliRunner().invoke(app, ["doctor", *options])
    assert result.exit_code == 0, result.output
    assert "xe7e" in result.output
