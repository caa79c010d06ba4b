"""Cameras over HTTP from a running emulator: contents, rendering on demand, and access control."""

import asyncio
import io
import json
import os
import signal
from collections.abc import AsyncIterator, Mapping
from contextlib import suppress
from http.client import HTTPConnection, HTTPResponse
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import pytest_asyncio
from PIL import Image

from client.cameras import CameraClient
from client.errors import CameraError as NoPicture
from emulator.app import Emulator
from emulator.config import EmulatorConfig, controller_config
from emulator.physics import open_cameras
from emulator.physics.cameras import CameraError
from emulator.servers import camera_drawing, cameras
from emulator.servers.cameras import CameraServer
from urproto.cameras import STREAM, pose_of
from urproto.compat_asyncio import timeout

PATIENCE_S = 90.0  # under load, as the renderer has the lowest priority
SCENE = """
objects:
  floor: {plane: {}, pose: [0, 0, -0.5], colour: [0.2, 0.2, 0.2]}
  lamp: {box: [0.3, 0.3, 0.1], pose: [-0.6, 0.1, 0.55], lamp: 0, colour: [1, 0, 0]}
cameras:
  over all: {pose: [-0.7, 0, 2.0, 3.14159265, 0, 0], size: [160, 120], fov: 0.9}
  wrist: {pose: [0.1, 0, 0], frame: flange, size: [64, 48]}
"""
OVER = "/cameras/over%20all"


class Answer(NamedTuple):
    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def error(self) -> str:
        return str(json.loads(self.body)["error"])


class Rig:
    """An emulator with cameras, and a client for them."""

    def __init__(self, robot: Emulator) -> None:
        self.robot = robot
        server = robot.servers["cameras"]
        assert isinstance(server, CameraServer)
        self.server = server
        self.port = robot.ports["cameras"]

    async def get(self, path: str, method: str = "GET", **headers: str) -> Answer:
        return await asyncio.to_thread(self._get, path, method, {k.replace("_", "-"): v for k, v in headers.items()})

    def _get(self, path: str, method: str, headers: Mapping[str, str]) -> Answer:
        connection = HTTPConnection("127.0.0.1", self.port, timeout=PATIENCE_S)
        try:
            connection.request(method, path, headers=dict(headers))
            response = connection.getresponse()
            return Answer(response.status, response.headers, response.read())
        finally:
            connection.close()

    async def array(self, path: str) -> Any:
        answer = await self.get(path)
        assert answer.status == 200, answer.body
        return np.load(io.BytesIO(answer.body))

    async def until(self, condition: Any) -> None:
        async with timeout(PATIENCE_S):
            while not condition():
                await asyncio.sleep(0.02)


@pytest_asyncio.fixture
async def rig(tmp_path: Path) -> AsyncIterator[Rig]:
    (scene := tmp_path / "cell.yaml").write_text(SCENE)
    config = controller_config("ur5", world=scene, physics=True, running=True)
    async with Emulator(EmulatorConfig(controller=config, ephemeral_ports=True)) as robot:
        try:
            open_cameras(robot.controller.world).close()
        except CameraError as error:
            pytest.skip(str(error))
        yield Rig(robot)


async def test_nothing_is_rendered_without_viewers(rig: Rig) -> None:
    index = json.loads((await rig.get("/cameras")).body)
    assert [camera["name"] for camera in index["cameras"]] == ["over all", "wrist"]
    assert [camera["frame"] for camera in index["cameras"]] == ["base", "flange"]
    page = await rig.get("/")
    assert b'alt="Live picture of camera over all"' in page.body
    assert page.headers["content-type"].startswith("text/html")
    await unknown_paths_are_one_line_errors(rig)
    await foreign_pages_are_refused(rig)
    assert not rig.server.drawing.at_work


async def test_pictures_show_the_current_scene(rig: Rig) -> None:
    """Also changes by the robot's program, here the colour of a lamp."""
    world, signals = rig.robot.controller.world, rig.robot.controller.signals
    dark, looks = await rig.array(f"{OVER}/rgb.npy"), world.model.geom_rgba.copy()
    signals.digital_outputs |= 1
    await rig.until(lambda: not np.array_equal(looks, world.model.geom_rgba))
    answer = await rig.get(f"{OVER}/rgbd.npz")
    both = np.load(io.BytesIO(answer.body))
    with open_cameras(world) as local:
        lamp = next(number for number, name in local.bodies.items() if name == "lamp")
        rgb, depth = local.rgbd("over all")
        bodies = local.segmentation("over all")
        pose = local.extrinsics("over all")
    assert np.array_equal(both["rgb"], rgb)
    assert both["depth"] == pytest.approx(depth, abs=1e-6)
    assert pose_of(answer.headers["x-camera-pose"]) == pytest.approx(pose, abs=1e-4)
    assert float(answer.headers["x-timestamp"]) <= rig.robot.controller.snapshot.timestamp
    assert 2.0 * dark[bodies == lamp, 0].mean() < rgb[bodies == lamp, 0].mean()
    assert np.array_equal(await rig.array(f"{OVER}/segmentation.npy"), bodies)
    mm = np.asarray(Image.open(io.BytesIO((await rig.get(f"{OVER}/depth.png")).body)))
    assert mm.dtype == np.uint16
    assert mm == pytest.approx(1e3 * depth, abs=0.6)
    world.covered.add("over all")
    assert not (await rig.array(f"{OVER}/rgb.npy")).any()


def pictures(response: HTTPResponse, count: int) -> list[tuple[float, Any]]:
    """Robot time and size of the first parts of a stream."""
    kind, _, boundary = response.headers["content-type"].partition("; boundary=")
    assert kind == "multipart/x-mixed-replace"
    found = []
    assert response.readline() == f"--{boundary}\r\n".encode()
    while len(found) < count:
        headers = {}
        while line := response.readline().strip():
            name, _, value = line.decode().partition(": ")
            headers[name.lower()] = value
        assert headers["content-type"] == "image/jpeg"
        picture = Image.open(io.BytesIO(response.read(int(headers["content-length"]))))
        assert response.readline() == b"\r\n"
        assert response.readline() == f"--{boundary}\r\n".encode()
        picture.load()
        found.append((float(headers["x-timestamp"]), picture.size))
    return found


async def test_a_stream_follows_the_robot_and_ends_with_its_viewer(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def look() -> list[tuple[float, Any]]:
        connection = HTTPConnection("127.0.0.1", rig.port, timeout=PATIENCE_S)
        try:
            connection.request("GET", f"{OVER}/{STREAM}?fps=20")
            return pictures(connection.getresponse(), 4)
        finally:
            connection.close()

    seen = await asyncio.to_thread(look)
    assert [size for _, size in seen] == [(160, 120)] * 4
    times = [time_s for time_s, _ in seen]
    assert times == sorted(set(times))
    await rig.until(lambda: not rig.server.connections)
    await viewers_are_counted(rig, monkeypatch)


async def unknown_paths_are_one_line_errors(rig: Rig) -> None:
    for path, status, error in (
        ("/cameras/none/rgb.jpg", 404, "there is no camera 'none'; there are: over all, wrist"),
        (f"{OVER}/rgb.gif", 404, "a camera does not serve rgb.gif; it serves: rgb.mjpeg, rgb.jpg"),
        ("/cameras/wrist", 404, "nothing is served at /cameras/wrist: see /cameras"),
        (f"{OVER}/{STREAM}?fps=31", 400, "fps must be a number from 0.01 to 30, not '31'"),
        (f"{OVER}/{STREAM}?fps=nan", 400, "fps must be a number"),
        (f"{OVER}/{STREAM}?fps=x", 400, "fps must be a number"),
    ):
        answer = await rig.get(path)
        assert (answer.status, answer.error[: len(error)]) == (status, error)


async def foreign_pages_are_refused(rig: Rig) -> None:
    assert (await rig.get("/cameras", Sec_Fetch_Site="cross-site")).error == "pages of other web sites have no access"
    assert (await rig.get("/cameras", Sec_Fetch_Site="same-site")).status == 403
    assert (await rig.get("/cameras", Sec_Fetch_Site="none")).status == 200
    refused = "the Host 'cameras.example' is not allowed: use an IP address in the URL"
    assert (await rig.get("/cameras", Host="cameras.example")).error == refused
    assert (await rig.get("/cameras", method="POST")).status == 405
    for path in ("/", "/cameras"):
        assert (await rig.get(path)).headers["cross-origin-resource-policy"] == "same-origin"


async def viewers_are_counted(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "_MAX_VIEWERS", 1)
    reader, writer = await asyncio.open_connection("127.0.0.1", rig.port)
    writer.write(f"GET {OVER}/{STREAM}?fps=0.01 HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    async with timeout(PATIENCE_S):
        await reader.readuntil(b"\r\n\r\n")
    assert (await rig.get(f"{OVER}/rgb.jpg")).error == "the limit of 1 viewers of cameras is reached: close one"
    assert (await rig.get("/cameras")).status == 200
    writer.write(b"x" * 70_000)  # a viewer of a stream sends no further requests
    async with timeout(PATIENCE_S):
        with suppress(ConnectionResetError):  # with unread bytes
            while await reader.read(1000):
                pass
    writer.close()
    await rig.until(lambda: not rig.server.connections)
    assert (await rig.get(f"{OVER}/rgb.jpg")).status == 200


@pytest.mark.long
async def test_the_renderer_exits_without_viewers_and_restarts_when_killed(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_drawing, "_RETRY_S", 0.0)
    assert (await rig.get("/cameras/wrist/rgb.jpg")).status == 200
    monkeypatch.setattr(camera_drawing, "_IDLE_S", 0.1)
    rig.server.drawing._new_request.set()
    await rig.until(lambda: not rig.server.drawing.at_work)
    monkeypatch.undo()
    monkeypatch.setattr(camera_drawing, "_RETRY_S", 0.0)
    started = []
    start = rig.server.drawing._start

    async def note() -> Any:
        started.append(await start())
        return started[-1]

    monkeypatch.setattr(rig.server.drawing, "_start", note)
    assert (await rig.get("/cameras/wrist/rgb.jpg")).status == 200
    os.kill(started[0].pid, signal.SIGKILL)
    await started[0].wait()
    lost = await rig.get("/cameras/wrist/rgb.jpg")
    assert (lost.status, lost.error[:46]) == (503, "the process that draws pictures has ended: its")
    assert (await rig.get("/cameras/wrist/rgb.jpg")).status == 200
    assert len(started) == 2


async def test_without_a_renderer_a_picture_is_a_one_line_error(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    drawing = camera_drawing.Drawing(rig.server.world, lambda: 0.0)
    monkeypatch.setenv("MUJOCO_EGL_DEVICE_ID", "99")  # this graphics card does not exist
    monkeypatch.setattr(rig.server, "_drawing", drawing)

    def send_request() -> None:
        with CameraClient(port=rig.port) as client:
            client.shot(client.chosen(["wrist"])[0], "rgb.jpg")

    with pytest.raises(NoPicture, match=r"no renderer is available .* install EGL"):
        await asyncio.to_thread(send_request)
    monkeypatch.delenv("MUJOCO_EGL_DEVICE_ID")
    with pytest.raises(NoPicture, match="no renderer is available"):  # not retried immediately
        await asyncio.to_thread(send_request)
    assert not drawing.at_work
    await drawing.close()


async def test_a_world_without_physics_has_no_camera_port(tmp_path: Path) -> None:
    (scene := tmp_path / "cell.yaml").write_text("objects:\n  floor: {plane: {}, pose: [0, 0, -0.5]}\n")
    config = EmulatorConfig(controller=controller_config("ur5", world=scene), ephemeral_ports=True)
    assert "cameras" not in config.wanted_ports
