"""The control API over HTTP, as its clients use it."""

import asyncio
import json
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Callable
from contextlib import closing
from typing import Any

import pytest
from openapi_spec_validator import validate
from typer.testing import CliRunner

from emulator import ctl
from emulator.app import Emulator
from emulator.config import ConfigError, EmulatorConfig
from emulator.machine import ControllerConfig
from tests.rows import each_row
from tests.ticking import StepClock
from urproto.controlapi import BadArguments, ControlClient, NoControlError, NotPossible, RemoteControl
from urproto.robots import load_model

HOST = "127.0.0.1"
JSON = {"Content-Type": "application/json"}


def config(**options: Any) -> EmulatorConfig:
    controller = ControllerConfig(model=load_model("ur3"), running=True)
    return EmulatorConfig(controller=controller, ephemeral_ports=True, **options)


@pytest.fixture
async def emulator() -> AsyncIterator[Emulator]:
    async with Emulator(config()) as running:
        yield running


async def run_in_thread(work: Callable[[], Any]) -> Any:
    """Do blocking work while the emulator continues."""
    return await asyncio.to_thread(work)


def request(emulator: Emulator, path: str, body: bytes | None = None, **headers: str) -> tuple[int, Any]:
    url = f"http://{HOST}:{emulator.ports['control']}{path}"
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        with urllib.request.urlopen(urllib.request.Request(url, body, JSON | named), timeout=10) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.load(error)


async def test_verbs_over_http(emulator: Emulator) -> None:
    def use() -> list[Any]:
        robot = RemoteControl(HOST, emulator.ports["control"])
        try:
            robot.set_digital_input(2, level=True)
            robot.run_until("actual_digital_input_bits == 4")
            robot.press_emergency_stop("robot")
            robot.run_until("robot_mode == POWER_OFF")
            with pytest.raises(NotPossible):
                robot.power_on()
            with pytest.raises(BadArguments):
                robot.set_digital_input(2, level="perhaps")  # type: ignore[arg-type]
            with pytest.raises(BadArguments, match="0 arguments"):
                robot.power_on(1)  # type: ignore[call-arg]
            with pytest.raises(AttributeError):
                robot.fly()  # type: ignore[attr-defined]
            return [robot.state(["safety_mode"]), robot.describe()["model"]]
        finally:
            robot.close()

    assert await run_in_thread(use) == [{"safety_mode": "ROBOT_EMERGENCY_STOP"}, "ur3"]


async def test_an_integer_answers_a_question_for_an_integer(emulator: Emulator) -> None:
    def use() -> Any:
        robot = RemoteControl(HOST, emulator.ports["control"])
        robot.send_script(
            'def ask():\n  global n = request_integer_from_primary_client("?")\n  while True:\n    sync()\n  end\nend\n'
        )
        robot.run_until("runtime_state == PLAYING")
        robot.answer_popup(robot.popups()[0]["id"], 12)
        robot.run_until("script_control_line > 2")
        variables = robot.variables()
        robot.close()
        return variables

    assert await run_in_thread(use) == {"n": "12"}


async def test_the_description_is_openapi(emulator: Emulator) -> None:
    status, description = await run_in_thread(lambda: request(emulator, "/openapi.json"))
    assert status == 200
    validate(description)
    assert "/verbs/set_joints" in description["paths"]


async def test_time_stops_and_continues_step_by_step(emulator: Emulator) -> None:
    control, period_s = emulator.control, emulator.controller.period_s

    def use() -> list[float]:
        robot = RemoteControl(HOST, emulator.ports["control"])
        with pytest.raises(NotPossible, match="pause_time"):
            robot.step()
        robot.pause_time()
        times = [robot.time()["time_s"], robot.step(), robot.step(100), robot.time()["time_s"]]
        times.append(robot.run_until("timestamp > 0"))
        assert robot.time()["paused"]
        robot.resume_time()
        robot.set_speed(0)  # as fast as possible
        robot.run_until("timestamp > 100")
        robot.close()
        return times

    first, second, third, fourth, fifth = await run_in_thread(use)
    assert second - first == pytest.approx(period_s)
    assert third - second == pytest.approx(100 * period_s)
    assert third == fourth == fifth
    assert not control.pace.paused


async def test_a_disconnected_client_does_not_keep_its_verb_waiting(emulator: Emulator) -> None:
    emulator.control.pause_time()
    _, writer = await asyncio.open_connection(HOST, emulator.ports["control"])
    body = b'{"condition": "timestamp < 0"}'
    writer.write(
        b"POST /verbs/run_until HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n\r\n%b" % (len(body), body)
    )
    while emulator.control.pace.paused:
        await asyncio.sleep(0)
    writer.close()
    while not emulator.control.pace.paused:
        await asyncio.sleep(0)


async def test_several_requests_on_one_connection_are_answered_in_order(emulator: Emulator) -> None:
    reader, writer = await asyncio.open_connection(HOST, emulator.ports["control"])
    for line in ("robotmode", "stop", "safetymode"):  # the second waits for a control period
        body = json.dumps({"line": line}).encode()
        writer.write(
            b"POST /verbs/dashboard HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
            b"Content-Length: %d\r\n\r\n%b" % (len(body), body)
        )
    answers = b""
    while answers.count(b'"result"') < 3:
        answers += await reader.read(4096)
    places = [answers.index(text) for text in (b"Robotmode: RUNNING", b"Stopped", b"Safetymode: NORMAL")]
    assert places == sorted(places)
    writer.close()


@each_row(
    ("path", "body", "headers", "status"),
    [
        ("/verbs/fly", b"{}", {}, 404),
        ("/nothing", None, {}, 404),
        ("/verbs/state", None, {}, 405),
        ("/verbs/state", b"[1]", {}, 400),
        ("/verbs/state", b"{", {}, 400),
        ("/verbs/state", b'{"a": "\xff"}', {}, 400),
        ("/verbs/state", b"[" * 100_000, {}, 400),
        ("/verbs/step", b'{"periods": 3}', {}, 409),
        ("/verbs/state", b"{}", {"Content_Type": "text/plain"}, 415),
        ("/verbs/state", b" " * (5 * 1024 * 1024), {}, 413),
        ("/verbs/state", b"{}", {"Host": "attacker.example"}, 403),
        ("/verbs/state", b"{}", {"Host": "attacker.example:30080"}, 403),
        ("/verbs/state", b"{}", {"Host": "[::1]:30080"}, 200),
        ("/verbs/state", b"", {"Host": "localhost:30080"}, 200),
    ],
)
async def test_invalid_requests_are_refused(
    emulator: Emulator, path: str, body: bytes | None, headers: dict[str, str], status: int
) -> None:
    answered, content = await run_in_thread(lambda: request(emulator, path, body, **headers))
    assert answered == status, content
    assert status == 200 or content["error"]


async def test_non_http_data_is_answered_and_disconnected(emulator: Emulator) -> None:
    reader, writer = await asyncio.open_connection(HOST, emulator.ports["control"])
    writer.write(bytes(range(256)) * 10)
    answer = await reader.read()
    assert answer.startswith(b"HTTP/1.1 400 ")
    writer.close()
    assert (await run_in_thread(lambda: request(emulator, "/health")))[0] == 200


async def test_requests_without_the_token_are_refused() -> None:
    async with Emulator(config(control_token="secret")) as emulator:
        port = emulator.ports["control"]

        def use() -> tuple[int, int]:
            with (
                closing(ControlClient(HOST, port, "guess")) as stranger,
                pytest.raises(NoControlError, match="token"),
            ):
                stranger.call("state", {})
            with closing(ControlClient(HOST, port, "secret")) as friend:
                friend.call("state", {})
                with pytest.raises(BadArguments, match="no verb 'fly'"):
                    friend.call("fly", {})
            return request(emulator, "/openapi.json")[0], request(emulator, "/health")[0]

        assert await run_in_thread(use) == (401, 200)


def test_listening_on_other_interfaces_requires_a_token() -> None:
    with pytest.raises(ConfigError, match="token"):
        config(control_host="0.0.0.0")
    assert config(host="0.0.0.0").host_of("control") == "127.0.0.1"
    assert config(host="127.0.0.9").host_of("control") == "127.0.0.9"
    assert config(control_host="0.0.0.0", control_token="t").host_of("control") == "0.0.0.0"


async def test_the_control_api_can_be_disabled() -> None:
    async with Emulator(config(control=False)) as emulator:
        assert "control" not in emulator.ports


async def test_the_speed_of_virtual_time_cannot_be_set() -> None:
    async with Emulator(config(), StepClock()) as emulator:
        status, answer = await run_in_thread(lambda: request(emulator, "/verbs/set_speed", b'{"speed": 2}'))
        assert (status, "virtual time" in answer["error"]) == (409, True)


class TestCommand:
    """``ur-emulator ctl``."""

    async def run(self, emulator: Emulator, *words: str) -> tuple[int, str]:
        place = ["--port", str(emulator.ports["control"])]
        result = await run_in_thread(lambda: CliRunner().invoke(ctl.app, [*place, *words], env={"COLUMNS": "200"}))
        return result.exit_code, result.output

    async def test_the_verbs_are_listed(self, emulator: Emulator) -> None:
        status, output = await self.run(emulator)
        assert status == 0
        assert "set_digital_input index level [group]" in output

    async def test_values_by_position_and_by_name(self, emulator: Emulator) -> None:
        assert await self.run(emulator, "set-joints", "0.1,-1.2,1,-1.4,-1.5,0.2") == (0, "")
        assert await self.run(emulator, "set_digital_input", "3", "on", "group=configurable") == (0, "")
        await self.run(emulator, "run_until", "actual_digital_input_bits == 2048")
        _, output = await self.run(emulator, "state", "actual_q,actual_digital_input_bits")
        assert json.loads(output) == {"actual_q": [0.1, -1.2, 1, -1.4, -1.5, 0.2], "actual_digital_input_bits": 2048}
        _, output = await self.run(emulator, "dashboard", "popup it = there")
        assert json.loads(output) == "showing popup"

    async def test_a_state_is_kept_in_a_file(self, emulator: Emulator, tmp_path) -> None:
        file = str(tmp_path / "state.json")
        assert await self.run(emulator, "save", "-f", file) == (0, "")
        await self.run(emulator, "set_speed_slider", "0.2")
        assert await self.run(emulator, "restore", "-f", file) == (0, "")
        await self.run(emulator, "run_until", "target_speed_fraction == 1")

    @pytest.mark.parametrize(
        ("words", "status", "complaint"),
        [
            (["fly"], 2, "unknown verb 'fly'"),
            (["set_digital_input", "3"], 2, "level"),
            (["power_on", "now"], 2, "takes 0 arguments"),
            (["step"], 1, "pause_time"),
            (["restore", "-f", "/nowhere/state.json"], 2, "No such file"),
        ],
    )
    async def test_errors_are_one_line(self, emulator: Emulator, words: list[str], status: int, complaint: str) -> None:
        exit_code, output = await self.run(emulator, *words)
        assert (exit_code, output.count("\n")) == (status, 1), output
        assert complaint in output

    def test_no_emulator_at_the_address(self) -> None:
        result = CliRunner().invoke(ctl.app, ["--port", "9", "state"])
        assert result.exit_code == 2
        assert "no control API on 127.0.0.1 port 9" in result.output
