"""An emulator of each known release starts: all of its ports answer as clients expect, or do not exist yet."""

import io

import pytest
from rich.console import Console

from emulator.app import Emulator
from emulator.config import EmulatorConfig
from emulator.first_screen import first_screen
from emulator.machine import ControllerConfig
from emulator.readiness import check_ready
from urproto.facts import known_releases
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion, Series

HOST = "127.0.0.1"
MODEL = {Series.CB3: "ur5", Series.E: "ur5e"}
FASTER = 10.0  # the first state of the primary interface comes after a tenth of a second of the robot's time


@pytest.mark.parametrize("release", known_releases(), ids=str)
async def test_every_port_answers(release: PolyscopeVersion) -> None:
    controller = ControllerConfig(model=load_model(MODEL[release.series]), version=release)
    async with Emulator(EmulatorConfig(controller=controller, ephemeral_ports=True, speed=FASTER)) as emulator:
        await check_ready(HOST, emulator.ports)
        screen = Console(file=io.StringIO(), width=150)
        screen.print(first_screen(emulator))
        assert ("rtde" in emulator.ports) == (release >= PolyscopeVersion(3, 2))
