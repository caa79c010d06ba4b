"""Invalid and unauthorised requests: 4xx, and no state is lost."""

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from emulator.app import Emulator
from tests.robotapi.rig import client, urpx
from urproto.robotapi import MAX_UPLOAD

Start = Callable[..., Awaitable[Emulator]]

JSON = {"Content-Type": "application/json"}
FORM = {"Content-Type": "multipart/form-data; boundary=b"}
PART = b'--b\r\nContent-Disposition: form-data; name="%s"\r\n\r\n%s\r\n--b--\r\n'
STATE, LOADED, PROGRAMS = "/robotstate/v1/state", "/program/v1/loaded", "/programs/v1/"

BAD: list[tuple[str, str, bytes, dict[str, str], int]] = [
    ("PUT", STATE, b"", JSON, 422),
    ("PUT", STATE, b"{", JSON, 422),
    ("PUT", STATE, b"\xff\xfe", JSON, 422),
    ("PUT", STATE, b"[" * 100_000, JSON, 422),
    ("PUT", STATE, b'["POWER_ON"]', JSON, 422),
    ("PUT", STATE, b'{"action": "FLY"}', JSON, 422),
    ("PUT", STATE, b'{"action": null}', JSON, 422),
    ("PUT", STATE, b"{}", JSON, 422),
    ("PUT", STATE, b'{"action": "POWER_ON"}', {"Content-Type": "text/plain"}, 415),
    ("PUT", STATE, b'{"action": "POWER_ON"}', {}, 415),
    ("POST", STATE, b'{"action": "POWER_ON"}', JSON, 405),
    ("DELETE", PROGRAMS, b"", {}, 405),
    ("TRACE", STATE, b"", {}, 405),
    ("PUT", LOADED, b'{"name": ""}', JSON, 422),
    ("PUT", LOADED, b'{"name": 7}', JSON, 422),
    ("PUT", LOADED, b'{"name": "../secret"}', JSON, 404),
    ("PUT", LOADED, b'{"name": "a\\u0000b"}', JSON, 404),
    ("GET", "/programs/v1/..%2fsecret", b"", {}, 404),
    ("GET", "/programs/v1/%2e%2e", b"", {}, 404),
    ("GET", "/programs/v1/a/b", b"", {}, 404),
    ("GET", "/nothing", b"", {}, 404),
    ("POST", PROGRAMS, b"?", JSON, 415),
    ("POST", PROGRAMS, b"?", {"Content-Type": "multipart/form-data"}, 422),
    ("POST", PROGRAMS, b"", FORM, 422),
    ("POST", PROGRAMS, PART % (b"other", urpx("x")), FORM, 422),
    ("POST", PROGRAMS, (PART % (b"file", urpx("x")))[:-6], FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", b"no program"), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", b'{"program": {"programContent": 5}}'), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx("../secret")), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx("..")), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx(".hidden")), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx("a\0b")), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx("x" * 300)), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", urpx("  ")), FORM, 422),
    ("PUT", PROGRAMS, PART % (b"file", urpx("Default program")), FORM, 422),
    ("POST", PROGRAMS, PART % (b"file", b" " * (MAX_UPLOAD + 1)), FORM, 413),
]


async def test_bad_requests_get_4xx_with_json_and_change_nothing(robot: Start, tmp_path: Path) -> None:
    secret = tmp_path.parent / f"{tmp_path.name}_secret.urpx"
    secret.write_bytes(urpx("secret"))
    (tmp_path / "good.urpx").write_bytes(urpx("good"))
    (tmp_path / "broken.urpx").write_bytes(b"{")
    emulator = await robot()
    async with client(emulator) as api:
        for method, path, body, headers, status in BAD:
            answer = await api.request(method, path, content=body, headers=headers)
            what = (method, path, body[:60], answer.text)
            assert answer.status_code == status, what
            content: Any = answer.json()
            assert content.get("message") or content["detail"][0]["msg"], what
        assert [each["name"] for each in (await api.get(PROGRAMS)).json()["programs"]] == ["Default program", "good"]
        assert (await api.put(LOADED, json={"name": "good"})).status_code == 200
    assert sorted(path.name for path in tmp_path.iterdir()) == ["broken.urpx", "good.urpx"]


async def test_validation_errors_name_the_location(robot: Start) -> None:
    async with client(await robot()) as api:
        (part,) = (await api.put(STATE, json={"action": "FLY"})).json()["detail"]
        assert (part["loc"], "FLY" in part["msg"]) == (["body", "action"], True)
        assert (await api.post(STATE)).headers["allow"] == "OPTIONS, PUT"


VISITORS: list[tuple[dict[str, str], int]] = [
    ({"Host": "evil.example"}, 403),
    ({"Host": "127.0.0.1.evil.example"}, 403),
    ({"Origin": "http://evil.example"}, 403),
    ({"Origin": "null"}, 403),
    ({"Host": "robot", "Origin": "http://evil.example"}, 403),
    ({"Host": "robot", "Origin": "http://robot"}, 200),  # a service of a container, and a page of the robot itself
    ({"Host": "robot.local"}, 200),
    ({"Host": "localhost:8000"}, 200),
    ({"Host": "[::1]:80"}, 200),
]


async def test_foreign_web_pages_cannot_use_the_robot(robot: Start) -> None:
    """A browser sends a form with a file for any page without asking; a page's own host name can resolve to the
    robot."""
    async with client(await robot()) as api:
        for number, (headers, status) in enumerate(VISITORS):
            name = f"visit {number}"
            program = {"file": ("x.urpx", urpx(name), "text/plain")}
            answer = await api.post(PROGRAMS, files=program, headers=headers)
            assert answer.status_code == status, headers
            assert (await api.get(f"/programs/v1/{name}")).status_code == (200 if status == 200 else 404), headers
