"""A camera server without a scene, for tests of its clients."""

import io
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from urproto.cameras import CameraDescription

WIDTH, HEIGHT = 8, 6
MATRIX = (10.0, 0.0, 4.0, 0.0, 10.0, 3.0, 0.0, 0.0, 1.0)
OVERVIEW = CameraDescription("over all", WIDTH, HEIGHT, MATRIX, "base", (0.5, 0.0, 2.0, 3.0, 0.0, 0.0))
WRIST = CameraDescription("wrist", WIDTH, HEIGHT, MATRIX, "flange", (0.1, 0.0, 0.0, 0.0, 0.0, 0.0))
BELT = CameraDescription("belt", WIDTH, HEIGHT, MATRIX, "", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
RGB = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3)
DEPTH = np.linspace(0.5, 2.0, HEIGHT * WIDTH, dtype=np.float32).reshape(HEIGHT, WIDTH)
JPEG = b"\xff\xd8 as it comes \xff\xd9"
POSE = (0.1, 0.2, 0.3, 0.0, 0.0, 1.0)


class Served:
    """The server's answers. time_s: robot time; requested: paths; answers: answers other than pictures, by
    path."""

    def __init__(self) -> None:
        self.port = 0
        self.cameras = [OVERVIEW, WRIST, BELT]
        self.time_s = 10.0
        self.requested: list[str] = []
        self.answers: dict[str, tuple[int, dict[str, str], bytes]] = {}

    def answer(self, path: str) -> tuple[int, dict[str, str], bytes]:
        self.requested.append(path)
        if path in self.answers:
            return self.answers[path]
        if path == "/cameras":
            return 200, {}, json.dumps({"cameras": [one.as_json() for one in self.cameras], "bodies": []}).encode()
        form = path.rpartition("/")[2]
        return 200, {"X-Timestamp": f"{self.time_s:.6f}", "X-Camera-Pose": ",".join(map(str, POSE))}, _picture(form)


def _picture(form: str) -> bytes:
    written = io.BytesIO()
    if form == "rgbd.npz":
        np.savez(written, rgb=RGB, depth=DEPTH)
    elif form == "rgb.jpg":
        written.write(JPEG)
    else:
        np.save(written, RGB if form == "rgb.npy" else DEPTH)
    return written.getvalue()


@contextmanager
def served_cameras(host: str = "127.0.0.1") -> Iterator[Served]:
    served = Served()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            status, headers, body = served.answer(self.path)
            self.send_response(status)
            for name, value in {"Content-Length": str(len(body)), **headers}.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    class Server(ThreadingHTTPServer):
        block_on_close = False

    server = Server((host, 0), Handler)
    served.port = server.server_port
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield served
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
