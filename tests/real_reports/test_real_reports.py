"""Reports of real controllers and the vendor's simulators, reproduced with the emulator in virtual time.

A report is a YAML file in ``reports``: where it was published, the robot, and the steps in order. A step sends one
request, then compares the values that it names:

    dashboard: a line          answer: a regular expression, of the whole answer
    gripper: a line            answer: the same
    script: URScript           ends when the program does, or with ``until``
    verb: [name, {arguments}]  of the control API
    wait_s                     lets time pass [s]
    until: a condition         as ``run_until`` takes it, in ``within_s`` of robot time
    takes_s                    how long the step took [s]
    state                      fields of the verb ``state``; a dot leads into one: "output_double_registers.0"
    primary                    the same of the primary interface's state: "joints.joints.2.mode"
    log                        regular expressions, each found in a line that the step added to the log

Modes are compared by name, bits as a number. Numbers agree within ``tolerance``, a mapping of names, or 1e-6 for
those it does not name. All differences of the emulator are reported, not only the first.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest
import yaml

from emulator.devices.gripper_requests import GripperSession
from emulator.servers.primary_state import robot_state
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.robotiq import RequestDecoder
from urproto.testing import virtual_robot

REPORTS = sorted((Path(__file__).parent / "reports").glob("*.yaml"))
TOLERANCE = 1e-6
WITHIN_S = 30.0
OF_A_STEP = {
    *("step", "dashboard", "gripper", "script", "verb", "answer"),
    *("wait_s", "until", "within_s", "takes_s", "state", "primary", "log", "tolerance"),
}


class Replay:
    """One robot that executes a report's steps one after the other."""

    def __init__(self, robot: Mapping[str, Any]) -> None:
        self._robot: VirtualRobot = virtual_robot(**robot)
        self._gripper = GripperSession()
        self._robot.step()

    def differences(self, step: Mapping[str, Any]) -> Iterator[str]:
        """Differences between this step and the report."""
        robot = self._robot
        began_s, lines = robot.controller.time_s, len(robot.controller.messages.history)
        answer = self._request(step)
        if "wait_s" in step:
            robot.step(round(step["wait_s"] / robot.controller.period_s))
        if "until" in step:
            robot.run_until(step["until"], step.get("within_s", WITHIN_S))
        took_s = robot.controller.time_s - began_s
        robot.step()  # effects of the step are published
        tolerance = step.get("tolerance", {})
        if "answer" in step and not re.fullmatch(step["answer"], answer or ""):
            yield f"answered {answer!r}, reported {step['answer']!r}"
        if "takes_s" in step:
            yield from _compared("takes_s", took_s, step["takes_s"], tolerance)
        for name, reported in step.get("state", {}).items():
            yield from _compared(name, _at(robot.state(), name), reported, tolerance)
        for name, reported in step.get("primary", {}).items():
            yield from _compared(name, _at(self._primary(), name), reported, tolerance)
        log = list(robot.controller.messages.history)[lines:]
        yield from (
            f"no {one!r} in the log: {log}"
            for one in step.get("log", ())
            if not any(re.search(one, line) for line in log)
        )

    def _request(self, step: Mapping[str, Any]) -> str | None:
        robot = self._robot
        if "dashboard" in step:
            return robot.dashboard(step["dashboard"])
        if "gripper" in step:
            assert robot.controller.gripper is not None
            requests = tuple(RequestDecoder().feed(step["gripper"].encode() + b"\n"))
            return self._gripper.answer(robot.controller.gripper, requests).decode().strip()
        if "verb" in step:
            name, arguments = step["verb"]
            getattr(robot, name)(**arguments)
        if "script" in step:
            assert robot.send_script(step["script"]), robot.log()
            if "until" not in step:
                self._run_out(step.get("within_s", WITHIN_S))
        return None

    def _run_out(self, within_s: float) -> None:
        robot, began_s = self._robot, self._robot.controller.time_s
        while robot.controller.programs.busy:
            assert robot.controller.time_s < began_s + within_s, f"the program still runs after {within_s} s"
            robot.step()

    def _primary(self) -> dict[str, Any]:
        controller = self._robot.controller
        return asdict(robot_state(controller.snapshot, controller.model))


def _at(values: Any, name: str) -> Any:
    for word in name.split("."):
        values = values[int(word)] if word.isdigit() else values[word]
    return values


def _compared(name: str, value: Any, reported: Any, tolerance: Mapping[str, float]) -> Iterator[str]:
    within = tolerance.get(name, TOLERANCE)
    if isinstance(reported, list):
        same = len(value) == len(reported) and all(map(lambda one, other: _same(one, other, within), value, reported))
    else:
        same = _same(value, reported, within)
    if not same:
        yield f"{name} is {value}, reported {reported} (tolerance {within})"


def _same(value: Any, reported: Any, within: float) -> bool:
    if reported is None or isinstance(reported, bool | str):
        return bool(value == reported)
    return bool(value == pytest.approx(reported, abs=within))


def read(report: Path) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load(report.read_text())
    assert document.keys() == {"source", "robot", "steps"}, report
    for step in document["steps"]:
        assert "step" in step, step
        assert not step.keys() - OF_A_STEP, step
    return document


@each_row("report", REPORTS, ids=lambda report: report.stem)
def test_the_emulator_reports_the_same(report: Path) -> None:
    document = read(report)
    replay = Replay(document["robot"])
    differences = [f"{step['step']}: {one}" for step in document["steps"] for one in replay.differences(step)]
    assert not differences, "\n".join([f"{report.name}, of {document['source']}", *differences])


def test_differences_are_reported() -> None:
    replay = Replay({"model": "ur3", "running": True})
    step = {
        "step": "all wrong",
        "dashboard": "robotmode",
        "answer": "Robotmode: IDLE",
        "takes_s": 1.0,
        "state": {"robot_mode": "IDLE", "actual_qd": [0, 0, 0, 0, 0, 1]},
        "primary": {"joints.joints.2.mode": 0},
        "log": ["never"],
    }
    assert [one.split()[0] for one in replay.differences(step)] == [
        *("answered", "takes_s", "robot_mode", "actual_qd", "joints.joints.2.mode", "no"),
    ]
