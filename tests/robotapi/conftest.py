"""A robot with PolyScope X, faster than real time."""

from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.machine import ControllerConfig
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

SPEED = 20.0


@pytest.fixture
async def robot(tmp_path: Path) -> AsyncIterator[Callable[..., Awaitable[Emulator]]]:
    """``await robot("10.12", ...)`` starts one; further arguments are passed to the controller."""
    running: list[Emulator] = []

    async def start(version: str = "10.12", **options: Any) -> Emulator:
        options = {"programs_dir": tmp_path, "remote_control": True, **options}
        controller = ControllerConfig(model=load_model("ur5e"), version=PolyscopeVersion.parse(version), **options)
        emulator = Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, speed=SPEED))
        running.append(await emulator.__aenter__())
        return emulator

    yield start
    for emulator in running:
        await emulator.__aexit__(None, None, None)
