"""The control program suits the version it is made for."""

import pytest

from client.driver.control_program import ControlProgram, ToolCommunicationSettings
from emulator.programs.compiling import LIBRARY_SET
from tests.rows import each_row
from urproto.errors import LocalProtocolError
from urproto.versions import PolyscopeVersion
from urscript.compiler import compile_script

PROGRAM = ControlProgram(host="10.0.0.1")
VERSIONS = ["3.14.0", "3.14.3", "3.15.8", "5.9.0", "5.9.4", "5.12", "5.22", "5.23", "5.25.1", "10.8", "10.12.1"]


def called(version):
    version = PolyscopeVersion.parse(version)
    program = compile_script(PROGRAM.render_headless(version), LIBRARY_SET, version)
    assert not program.warnings
    assert program.name == "external_control"
    return set(program.builtins)


@pytest.mark.parametrize("version", VERSIONS)
def test_every_version_has_all_that_is_called(version):
    assert {"servoj", "speedj", "speedl", "movej", "movel", "movep", "movec"} <= called(version)
    assert "{{" not in PROGRAM.render(PolyscopeVersion.parse(version))


@each_row(
    ("name", "without", "with_it"),
    [
        ("optimovej", ["3.15.8", "5.20", "10.7"], ["5.21", "10.8"]),
        ("direct_torque", ["3.15.8", "5.22", "10.9"], ["5.23", "5.25.1", "10.10"]),
        ("set_target_payload", ["3.15.8", "5.9.4"], ["5.10", "10.8"]),
        ("ft_rtde_input_enable", ["3.14.0", "5.9.0"], ["3.14.1", "5.9.1"]),
        ("force_mode_set_gain_scaling", ["3.15.8"], ["5.9.0"]),
    ],
)
def test_what_a_version_lacks_is_not_named(name, without, with_it):
    for version in without:
        assert name not in PROGRAM.render(PolyscopeVersion.parse(version)), version
    for version in with_it:
        assert name in PROGRAM.render(PolyscopeVersion.parse(version)), version


def test_the_tool_is_set_up_at_the_beginning():
    program = ControlProgram(host="10.0.0.1", tool_voltage=24, tool_communication=ToolCommunicationSettings(9600))
    text = program.render(PolyscopeVersion(5, 22))
    assert "\nset_tool_voltage(24)\nset_tool_communication(True, 9600, 0, 1, 1.5, 3.5)\n" in text


def test_the_urcap_finds_its_anchors():
    lines = PROGRAM.render(PolyscopeVersion(5, 22)).splitlines()
    anchors = ["# HEADER_BEGIN", "# HEADER_END", "# NODE_CONTROL_LOOP_BEGINS", "# NODE_CONTROL_LOOP_ENDS"]
    places = [lines.index(anchor) for anchor in anchors]
    assert places == sorted(places)
    assert places[0] == 0


@each_row("wrong", [{"servoj_gain": 50}, {"servoj_lookahead_s": 1.0}, {"host": 'x", 1)\nhalt'}, {"host": ""}])
def test_wrong_options(wrong):
    with pytest.raises(LocalProtocolError):
        ControlProgram(**({"host": "10.0.0.1"} | wrong))
