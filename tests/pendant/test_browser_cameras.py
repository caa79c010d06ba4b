"""The Cameras screen: pictures and descriptions, only for robots with cameras."""

import io
import json

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, expect

from tests.pendant.conftest import VIEWPORT, Rig, eventually
from tests.pendant.pendants import pendant
from tests.pendant.test_browser_access import CUT_OFF, persistent_problems, violations
from tests.served_cameras import HEIGHT, WIDTH, Served, served_cameras

PORT = 6083
STREAM, STILL, SEGMENTATION = (f"/cameras/over%20all/{form}" for form in ("rgb.mjpeg", "rgb.jpg", "segmentation.npy"))


def jpeg() -> bytes:
    written = io.BytesIO()
    Image.new("RGB", (WIDTH, HEIGHT), (200, 30, 30)).save(written, "JPEG")
    return written.getvalue()


def serve_pictures(served: Served) -> None:
    picture, bodies = jpeg(), io.BytesIO()
    np.save(bodies, np.array([[1] * WIDTH] * 3 + [[0] * WIDTH] * 2 + [[-1] * (WIDTH - 2) + [2, 3]], np.int32))
    part = b"--p\r\nContent-Type: image/jpeg\r\n\r\n" + picture + b"\r\n--p--\r\n"
    served.answers[STREAM] = (200, {"Content-Type": "multipart/x-mixed-replace; boundary=p"}, part)
    served.answers[STILL] = (200, {}, picture)
    served.answers[SEGMENTATION] = (200, {}, bodies.getvalue())
    index = {
        "cameras": [camera.as_json() for camera in served.cameras],
        "bodies": ["world", "red part", "ur/jaws", "ur/tool"],
    }
    served.answers["/cameras"] = (200, {}, json.dumps(index).encode())


def wait_for_picture(page: Page) -> None:
    """Wait until the browser has decoded a picture."""
    drawn = "() => document.querySelector('[data-testid=camera-picture]')?.naturalWidth > 0"
    eventually(lambda: page.evaluate(drawn))


@pytest.mark.long
def test_picture_and_description_are_shown(rig: Rig, browser: Browser) -> None:
    options = ("--port", str(PORT), "--control-port", "0")
    context = browser.new_context(viewport=VIEWPORT)
    try:
        with served_cameras(rig.host) as served, pendant(rig.host, *options, "--camera-port", str(served.port)):
            serve_pictures(served)
            page = context.new_page()
            page.goto(f"http://{rig.host}:{PORT}/initialize")
            page.get_by_test_id("tab-cameras").click()
            wait_for_picture(page)
            picture = page.get_by_test_id("camera-picture")
            assert (
                picture.get_attribute("alt")
                == "Picture of the camera over all, live; the objects in view are listed below it"
            )
            description = "It sees: red part (50.0 %), the arm (4.2 %)."
            expect(page.get_by_test_id("camera-view")).to_have_text(description)
            assert not persistent_problems("cameras: ", lambda: violations(page, "html"))
            assert page.evaluate(CUT_OFF) == []
            page.get_by_test_id("camera-pause").click()  # moving content can be paused: WCAG 2.2.2
            expect(picture).to_have_attribute(
                "alt", "Picture of the camera over all, stopped; the objects in view are listed below it"
            )
            wait_for_picture(page)
            assert STILL in served.requested
            page.get_by_test_id("tab-log").click()
            expect(page.get_by_test_id("camera-picture")).to_have_count(0)
            served.answers["/cameras"] = (200, {}, b'{"cameras": [], "bodies": []}')
            expect(page.get_by_test_id("tab-cameras")).to_be_hidden()
    finally:
        context.close()


@pytest.mark.long
@pytest.mark.parametrize("path", ["/camera/wrist/stream", "/camera/wrist/still"])
def test_robot_without_cameras_has_no_pictures(rig: Rig, browser: Browser, path: str) -> None:
    page = browser.new_page()
    try:
        answer = page.goto(rig.url + path)
        assert answer is not None
        assert answer.status == 502
        assert "no cameras at" in answer.text()
        page.goto(f"{rig.url}/initialize")
        expect(page.locator(".robot-name")).to_contain_text("UR3")
        expect(page.get_by_test_id("tab-cameras")).to_be_hidden()
    finally:
        page.close()
