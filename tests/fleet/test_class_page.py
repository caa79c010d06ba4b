"""The page of a class: passwords, the teacher's commands, links to pendants."""

import asyncio
import http.client
import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from math import pi
from types import SimpleNamespace
from typing import Any

import pytest
from fleet_rig import DEADLINE_S, dashboard, host, running, wait_for_end

from emulator.config import ConfigError, EmulatorConfig
from emulator.fleet.class_robot import picture_of
from emulator.fleet.class_server import ClassServer, check_class, class_passwords
from emulator.machine import ControllerConfig
from urproto.controlapi import RemoteControl
from urproto.robots import load_model

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has many loopback addresses")
PORT = 6070
COUNT = (
    "def count():\n  while True:\n    movej([1, -1.5, 1, -1, -1, 0])\n    movej([0, -1.5, 1, -1, -1, 0])\n  end\nend\n"
)


class Visitor:
    """A browser with its cookies."""

    def __init__(self) -> None:
        self.cookie = ""

    def request(
        self, method: str, path: str, content: object = None, at: tuple[str, int] = ("", PORT), **headers: str
    ) -> tuple[int, Any, http.client.HTTPMessage]:
        connection = http.client.HTTPConnection(at[0] or host(0), at[1], timeout=DEADLINE_S)
        with closing(connection):
            sent = {"Content-Type": "application/json", "Cookie": self.cookie, **headers}
            connection.request(method, path, None if content is None else json.dumps(content), sent)
            response = connection.getresponse()
            body = response.read()
            is_json = response.headers.get_content_type() == "application/json"
            return response.status, json.loads(body) if is_json and body else body, response.headers

    def log_in(self, password: str) -> str:
        status, answer, headers = self.request("POST", "/login", {"password": password})
        assert status == 200, answer
        self.cookie = headers["Set-Cookie"].partition(";")[0]
        return str(answer["role"])

    def robots(self) -> list[dict[str, Any]]:
        status, answer, _ = self.request("GET", "/robots")
        assert status == 200
        return list(answer["robots"])

    def command(self, action: str, *robots: int, **more: str) -> Any:
        return self.request("POST", "/robots", {"action": action, "robots": robots, **more})[:2]

    def wait_for(self, condition: Callable[[list[dict[str, Any]]], object]) -> list[dict[str, Any]]:
        deadline = time.monotonic() + DEADLINE_S
        while not condition(robots := self.robots()):
            assert time.monotonic() < deadline, robots
            time.sleep(0.05)
        return robots


@pytest.fixture(scope="module")
def passwords(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, str]]:
    """Passwords of teacher and students of a class of three."""
    arguments = ("--count", "3", "--running", "--processes", "1", "--class-port", str(PORT))
    with running(tmp_path_factory.mktemp("class"), *arguments, "--student-password", "for us") as fleet:
        shown = fleet.read_until("Ready: every port of 3 robots answers")
        assert f"Class page: http://{host(0)}:{PORT}" in shown
        yield shown.partition("password for the teacher: ")[2].split()[0], "for us"
        with open(f"/proc/{fleet.process.pid}/task/{fleet.process.pid}/children") as children:
            pids = [int(pid) for pid in children.read().split()]
        assert fleet.interrupt()[0] == 0
        for pid in pids:
            wait_for_end(pid)


def test_roles(passwords: tuple[str, str]) -> None:
    teacher, student, stranger = Visitor(), Visitor(), Visitor()
    assert (teacher.log_in(passwords[0]), student.log_in(passwords[1])) == ("teacher", "student")
    for method, path, content, status in (
        ("GET", "/", None, 200),
        ("GET", "/robots", None, 401),
        ("POST", "/robots", {"action": "stop", "robots": [1]}, 401),
        ("POST", "/login", {"password": "for them"}, 401),
        ("POST", "/login", {"password": 1}, 400),
        ("GET", "/robot/4", None, 404),
        ("GET", "/robot/x", None, 404),
        ("DELETE", "/robots", None, 405),
    ):
        assert stranger.request(method, path, content)[0] == status, (method, path)
    assert stranger.request("GET", "/robot/2")[2]["Location"] == "/#/robot/2"
    assert student.command("stop", 1) == (403, {"error": "only the teacher stops, resets and names robots"})
    assert teacher.request("GET", "/robots", **{"Sec-Fetch-Site": "cross-site"})[0] == 403
    assert teacher.request("GET", "/", Host="evil.example")[0] == 403
    assert teacher.command("name", 2, name="Ada")[0] == 200
    assert [robot["name"] for robot in student.robots()] == ["Robot 1", "Ada", "Robot 3"]


def test_stop_and_reset(passwords: tuple[str, str]) -> None:
    teacher = Visitor()
    teacher.log_in(passwords[0])
    first = teacher.wait_for(lambda robots: all("mode" in robot for robot in robots))
    with closing(RemoteControl(host(0))) as one, closing(RemoteControl(host(2))) as three:
        one.send_script(COUNT)
        three.send_script(COUNT)
        teacher.wait_for(lambda now: [robot["runtime"] for robot in now] == ["PLAYING", "STOPPED", "PLAYING"])
        teacher.wait_for(lambda now: now[0]["arm"] != first[0]["arm"])
        assert teacher.command("stop", 1) == (200, {"failed": {}})
        teacher.wait_for(lambda now: [robot["runtime"] for robot in now] == ["STOPPED", "STOPPED", "PLAYING"])
        one.press_emergency_stop()
        three.protective_stop()
        assert teacher.command("reset", 1, 2, 3) == (200, {"failed": {}})
        teacher.wait_for(lambda now: [robot["arm"] for robot in now] == [robot["arm"] for robot in first])
        assert {(robot["mode"], robot["safety"]) for robot in teacher.robots()} == {("RUNNING", "NORMAL")}
    assert dashboard(host(2), "programState").startswith("STOPPED")


@pytest.mark.long
def test_pendants_open_only_with_the_link(passwords: tuple[str, str]) -> None:
    student = Visitor()
    student.log_in(passwords[1])
    pendant = (host(1), 6080)
    status, _, headers = student.request("GET", "/robot/2")
    assert status == 303
    address, _, key = headers["Location"].partition("/?")
    assert address == f"http://{pendant[0]}:{pendant[1]}"
    browser = Visitor()
    for path in ("/", "/move", "/browsers", "/?key=guess"):
        assert browser.request("GET", path, at=pendant)[0] == 401, path
    status, _, headers = browser.request("GET", f"/?{key}", at=pendant)
    assert (status, headers["Location"]) == (303, "/")
    browser.cookie = headers["Set-Cookie"].partition(";")[0]
    assert browser.request("GET", "/browsers", at=pendant)[:2] == (200, [])
    robots = student.wait_for(lambda now: any("primary" in client for client in now[1].get("clients", ())))
    assert "primary" not in str(robots[0]["clients"])


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"control": False}, "needs the control API of every robot: leave out --no-control"),
        ({"ephemeral_ports": True}, "needs the usual ports: leave out --ephemeral-ports"),
    ],
)
def test_impossible_classes_are_refused(options: dict[str, bool], problem: str) -> None:
    config = EmulatorConfig(controller=ControllerConfig(model=load_model("ur3")), **options)
    with pytest.raises(ConfigError, match=problem):
        check_class([config])


def test_passwords_are_new_unless_given_and_differ() -> None:
    assert class_passwords("a", "b") == {"teacher": "a", "student": "b"}
    assert class_passwords("", "")["teacher"] != class_passwords("", "")["teacher"]
    with pytest.raises(ConfigError, match="are the same: students could stop all robots"):
        class_passwords("a", "a")


def test_a_browser_asks_again_while_its_pendant_starts() -> None:
    async def late(_running: object) -> str:
        raise TimeoutError

    robot: Any = SimpleNamespace(name="Robot 2", open_pendant=late)
    server: Any = SimpleNamespace(_running=None)
    response = asyncio.run(ClassServer.open_pendant(server, robot))
    assert (response.status, response.headers) == (503, {"Refresh": "2"})
    assert "is still starting" in response.content["error"]


def test_the_picture_shows_the_pose() -> None:
    draw = picture_of(load_model("ur3"))
    up, flat = draw([0.0, -pi / 2, 0.0, -pi / 2, 0.0, 0.0]), draw([0.0] * 6)
    assert min(y for _, _, _, y, _ in up) < -90
    assert min(y for _, _, _, y, _ in flat) > -60
    assert max(abs(x) for lines in (up, flat) for x1, _, x2, _, _ in lines for x in (x1, x2)) <= 100
