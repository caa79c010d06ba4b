"""Answers of the Robot API to httpx: each request by version, mode and program."""

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import httpx
import pytest
from jsonschema import Draft202012Validator
from openapi_spec_validator import validate

from emulator.app import Emulator
from emulator.lifecycle.runstate import StopCause
from tests.robotapi.rig import client, node, urpx, wait
from urproto.compat_asyncio import timeout
from urproto.robotapi import DEFAULT_PROGRAM, ENDPOINTS, URCAPS
from urproto.versions import PolyscopeVersion

Start = Callable[..., Awaitable[Emulator]]


async def put(api: httpx.AsyncClient, path: str, **body: str) -> int:
    return (await api.put(path, json=body)).status_code


async def get_field(api: httpx.AsyncClient, path: str, key: str) -> Any:
    return (await api.get(path)).json()[key]


async def reached(api: httpx.AsyncClient, path: str, key: str, value: str) -> None:
    async with timeout(30.0):
        while await get_field(api, path, key) != value:
            pass


def form(data: bytes) -> dict[str, Any]:
    return {"file": ("program.urpx", data, "text/plain")}


@pytest.mark.parametrize("version", ["10.11", "10.12", "10.13"])
async def test_the_document_is_valid_and_matches_the_version(robot: Start, version: str) -> None:
    async with client(await robot(version)) as api:
        document = (await api.get("/openapi.json")).json()
        validate(document)
        described = {(method.upper(), path) for path, here in document["paths"].items() for method in here}
        polyscope = PolyscopeVersion.parse(version)
        assert described == {(each.method, each.path) for each in ENDPOINTS if each.available.covers(polyscope)}
        api_version = tuple(map(int, document["info"]["version"].split(".")))
        assert (api_version >= (3, 1, 4)) is (version != "10.11")  # the C++ client depends on it
        assert (api_version == (3, 1, 6)) is (version == "10.13")  # simulator of 10.13.0, public report
        assert (await api.get("/robotstate/v1/robotmode")).status_code == (404 if version == "10.11" else 200)


async def test_before_10_11_there_is_no_api_but_start_scripts_get_answers(robot: Start) -> None:
    emulator = await robot("10.7")
    async with client(emulator) as api:
        assert (await api.get("/openapi.json")).status_code == 404
        assert (await put(api, "/robotstate/v1/state", action="POWER_ON")) == 404
        start_script = await api.get(f"http://127.0.0.1:{emulator.ports['robot api']}{URCAPS}")
        assert (start_script.status_code, start_script.json()) == (200, [])


async def test_answers_match_the_document(robot: Start) -> None:
    async with client(await robot()) as api:
        document = (await api.get("/openapi.json")).json()
        looked = 0
        for path, here in document["paths"].items():
            if "get" in here and "{" not in path:
                schema = here["get"]["responses"]["200"]["content"]["application/json"]["schema"]
                whole = {**schema, "components": document["components"]}
                Draft202012Validator(whole).validate((await api.get(path)).json())
                looked += 1
        assert looked == 7


async def test_the_arm(robot: Start) -> None:
    emulator = await robot()
    state, mode, safety = "/robotstate/v1/state", "/robotstate/v1/robotmode", "/robotstate/v1/safetymode"
    async with client(emulator) as api:
        for action, becomes in (
            ("POWER_ON", "IDLE"),
            ("BRAKE_RELEASE", "RUNNING"),
            ("POWER_ON", "RUNNING"),
            ("POWER_OFF", "POWER_OFF"),
            ("BRAKE_RELEASE", "RUNNING"),
        ):
            assert (await put(api, state, action=action), await get_field(api, mode, "mode")) == (200, becomes)
        assert await put(api, state, action="UNLOCK_PROTECTIVE_STOP") == 409
        emulator.controller.protective_stop(StopCause(209, 0, ""))
        assert await get_field(api, safety, "mode") == "PROTECTIVE_STOP"
        assert await put(api, state, action="UNLOCK_PROTECTIVE_STOP") == 200  # immediately, as in the vendor's tests
        assert await get_field(api, safety, "mode") == "NORMAL"
        emulator.control.press_emergency_stop("robot")  # type: ignore[attr-defined]
        await reached(api, safety, "mode", "EMERGENCY_STOP")
        refusal = await api.put(state, json={"action": "POWER_ON"})
        assert refusal.status_code == 409
        assert "EMERGENCY_STOP" in refusal.json()["message"]


async def test_programs_are_stored_loaded_and_played(robot: Start, tmp_path: Path) -> None:
    async with client(await robot(running=True)) as api:
        loaded, state = "/program/v1/loaded", "/program/v1/state"
        assert await get_field(api, loaded, "name") == DEFAULT_PROGRAM
        program = urpx("a job", wait(5.0))
        assert (await api.post("/programs/v1/", files=form(program))).json()["programName"] == "a job"
        again = await api.post("/programs/v1/", files=form(program))
        assert (again.status_code, "already" in again.json()["message"]) == (400, True)
        longer = urpx("a job", wait(600.0))
        assert (await api.put("/programs/v1/", files=form(longer))).json()["programName"] == "a job"
        assert (await api.put("/programs/v1/", files=form(urpx("nobody")))).status_code == 404
        assert (await api.get("/programs/v1/a%20job")).content == longer
        assert [each["name"] for each in await get_field(api, "/programs/v1/", "programs")] == [
            DEFAULT_PROGRAM,
            "a job",
        ]
        assert [path.name for path in tmp_path.iterdir()] == ["a job.urpx"]
        assert await put(api, loaded, name="nobody") == 404
        done = await api.put(loaded, json={"name": "a job"})
        assert (done.status_code, done.json()["message"]) == (200, "Program loaded successfully")  # public report
        for action, becomes in (("play", "PLAYING"), ("pause", "PAUSED"), ("resume", "PLAYING"), ("stop", "STOPPED")):
            assert (await put(api, state, action=action), await get_field(api, state, "state")) == (200, becomes)
        assert await put(api, state, action="resume") == 409
        assert await put(api, state, action="pause") == 409
        assert await put(api, "/program/v1/load", programName=DEFAULT_PROGRAM) == 200  # as before 10.12
        assert await get_field(api, loaded, "name") == DEFAULT_PROGRAM


async def test_rtde_stops_warning_once_the_arm_was_switched_on(robot: Start) -> None:
    emulator = await robot()
    async with client(emulator) as api:
        server = emulator.servers["rtde"]
        assert server.host.never_on  # type: ignore[attr-defined]
        for action in ("POWER_ON", "POWER_OFF"):
            assert await put(api, "/robotstate/v1/state", action=action) == 200
        assert not server.host.never_on  # type: ignore[attr-defined]


async def test_an_unrunnable_program_is_refused_naming_its_node_and_changes_nothing(robot: Start) -> None:
    async with client(await robot()) as api:
        await api.post("/programs/v1/", files=form(urpx("odd", node("vendor-thing", "v"))))
        refusal = await api.put("/program/v1/loaded", json={"name": "odd"})
        assert refusal.status_code == 422
        assert "unknown node vendor-thing" in refusal.json()["message"]
        assert await get_field(api, "/program/v1/loaded", "name") == DEFAULT_PROGRAM


async def test_uploads_are_kept_even_without_a_programs_folder(robot: Start) -> None:
    async with client(await robot(programs_dir=None)) as api:
        assert (await api.post("/programs/v1/", files=form(urpx("kept")))).status_code == 200
        assert [each["name"] for each in await get_field(api, "/programs/v1/", "programs")] == [DEFAULT_PROGRAM, "kept"]


async def test_local_control(robot: Start) -> None:
    """Reading and storing are allowed, as in the vendor's tests; actions are reserved to the pendant."""
    emulator = await robot(remote_control=False, enforce_remote_control=True)
    async with client(emulator) as api:
        assert await get_field(api, "/system/v1/controlmode", "mode") == "LOCAL"
        assert (await api.post("/programs/v1/", files=form(urpx("stored")))).status_code == 200
        acting = [each for each in ENDPOINTS if each.remote_only]
        bodies: dict[str, dict[str, str]] = {
            "/robotstate/v1/state": {"action": "POWER_ON"},
            "/program/v1/load": {"programName": "stored"},
            "/program/v1/loaded": {"name": "stored"},
            "/program/v1/state": {"action": "play"},
        }
        for each in acting:
            assert await put(api, each.path, **bodies[each.path]) == 403, each
        assert await get_field(api, "/robotstate/v1/robotmode", "mode") == "POWER_OFF"
        emulator.controller.remote_control = True
        assert await get_field(api, "/system/v1/controlmode", "mode") == "REMOTE"
        assert await put(api, "/robotstate/v1/state", action="POWER_ON") == 200


async def test_alternative_paths_redirect(robot: Start) -> None:
    async with client(await robot(), follow_redirects=True) as api:
        assert (await api.get("/programs/v1")).json()["programs"]
        program = urpx("over there")
        assert (await api.post("/programs/v1", files=form(program))).json()["programName"] == "over there"
