"""An openpi server computes the actions: with openpi's own client and server, which are not in the tests' environment.

pip install '.[learning]' openpi-client openpi-server pytest
"""

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("openpi_server", reason="see above")

from openpi_client.base_policy import BasePolicy
from openpi_server.websocket_policy_server import WebsocketPolicyServer
from typer.testing import CliRunner

from emulator.cli import app

EXAMPLE = Path(__file__).parents[2] / "examples" / "learning" / "openpi_policy.py"
CHUNK = 16


class Turn(BasePolicy):
    """Turns the base, and closes the gripper."""

    def __init__(self) -> None:
        self.asked: list[dict[str, object]] = []

    def infer(self, obs: dict[str, object]) -> dict[str, object]:
        self.asked.append(obs)
        joints = np.asarray(obs["joints"], np.float32)
        chunk = np.tile(np.append(joints, 1.0), (CHUNK, 1))
        chunk[:, 0] += 0.01 * np.arange(1, CHUNK + 1)
        return {"actions": chunk}


@contextmanager
def served(policy: BasePolicy) -> Iterator[int]:
    """openpi's server on a free port."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port: int = free.getsockname()[1]
    loop = asyncio.new_event_loop()
    task = loop.create_task(WebsocketPolicyServer(policy, "127.0.0.1", port).run())
    thread = threading.Thread(target=lambda: loop.run_until_complete(asyncio.wait([task])))
    thread.start()
    try:
        yield port
    finally:
        loop.call_soon_threadsafe(task.cancel)
        thread.join()
        loop.close()


def evaluate(monkeypatch: pytest.MonkeyPatch, port: int) -> None:
    monkeypatch.setenv("OPENPI_HOST", "127.0.0.1")
    monkeypatch.setenv("OPENPI_PORT", str(port))
    words = ["evaluate", "pick_and_place", "--policy", f"{EXAMPLE}:load", "--episodes", "1", "--steps", "25"]
    words += ["--option", "control_mode=joint_position", "--option", "cameras=overview,wrist", "--workers", "1"]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output


@pytest.mark.filterwarnings("ignore:connect:DeprecationWarning")  # openpi-client calls websockets as it was
def test_a_server_is_asked_once_for_each_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    policy = Turn()
    with served(policy) as port:
        evaluate(monkeypatch, port)
    assert len(policy.asked) == 3  # 25 steps, 10 of each chunk
    first, *_, last = policy.asked
    assert first["base_rgb"].shape == first["wrist_rgb"].shape == (224, 224, 3)
    assert first["prompt"] == "bring the part to its goal"
    assert (first["gripper"].tolist(), last["gripper"].tolist()) == ([0.0], [1.0])
    assert 0.1 < last["joints"][0] - first["joints"][0] < 0.2
