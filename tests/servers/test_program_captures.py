"""Messages about programs to a primary client, byte for byte as in captures of a 5.4 simulator."""

from pathlib import Path

import pytest
from server_rig import MemoryClient

from emulator.app import make_servers
from emulator.commands.requests import ScriptUnit
from emulator.controller import Controller
from emulator.machine import ControllerConfig
from urproto.robots import load_model
from urproto.versions import PolyscopeVersion

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
STAMP = slice(5, 13)  # of a message


def golden(name: str) -> bytes:
    lines = (GOLDEN / f"{name}.hex").read_text().splitlines()
    return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))


def split(data: bytes) -> list[bytes]:
    messages = []
    while data:
        size = int.from_bytes(data[:4], "big")
        messages.append(data[:size])
        data = data[size:]
    return messages


def received(script: str) -> list[bytes]:
    """Messages to a primary client of a UR10e within 0.3 s after a script, without the states."""
    config = ControllerConfig(model=load_model("ur10e"), version=PolyscopeVersion(5, 4), running=True)
    controller = Controller(config)
    servers = {server.name: server for server in make_servers(controller)}
    client = MemoryClient(servers["primary"])
    controller.post(ScriptUnit(script, "block"))
    for _ in range(150):
        controller.tick()
    # without the version message, the short one after it, and states
    return [message for message in split(client.take())[2:] if message[4] != 16]


@pytest.mark.parametrize(
    ("script", "name"),
    [("def silly()\nend\n", "syntax_error_5.4"), ('def silly():\n txtmsg("")\nend\n', "compile_error_5.4")],
)
def test_a_program_that_does_not_compile(script: str, name: str) -> None:
    assert received(script) == [golden(name)]


def test_the_end_of_a_program() -> None:
    started, *end = received("def silly():\nend\n")
    assert b"PROGRAM_XXX_STARTED" in started
    stopped, variables, modbus = split(golden("key_stopped_5.4"))
    assert modbus[4] == 5  # the emulator has no Modbus signals to report
    assert end[1] == variables
    assert (end[0][: STAMP.start], end[0][STAMP.stop :]) == (stopped[: STAMP.start], stopped[STAMP.stop :])
