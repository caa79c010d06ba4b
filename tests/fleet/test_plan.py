"""The robots of a fleet, and error messages."""

import pytest
from typer.testing import CliRunner

from emulator.config import ConfigError
from emulator.fleet.command import app
from emulator.fleet.plan import FleetFile, place
from emulator.fleet.supervisor import share_out
from emulator.options import ROBOT_OPTIONS, configure
from tests.rows import each_row


def plan(path, text: str):
    path.write_text(text)
    return place(FleetFile(ROBOT_OPTIONS).read(path), configure, "127.0.0.1")


def test_addresses_are_consecutive_and_skip_explicit_ones() -> None:
    robots = [{}, {}, {"host": "127.0.0.2"}, {}]
    assert [config.host for config in place(robots, configure, "127.0.0.1")] == [
        "127.0.0.1",
        "127.0.0.3",
        "127.0.0.2",
        "127.0.0.4",
    ]


def test_addresses_continue_after_255() -> None:
    hosts = [config.host for config in place([{}, {}], configure, "127.0.0.255")]
    assert hosts == ["127.0.0.255", "127.0.1.0"]


def test_every_robot_option_is_accepted_in_a_file(tmp_path) -> None:
    (tmp_path / "urp").mkdir()
    first, second = plan(
        tmp_path / "fleet.yaml",
        "robots: [{programs: urp, script-network: loopback, encoder0-speed: 5}, {model: UR10e, port_offset: 7}]",
    )
    assert first.controller.programs_dir == (tmp_path / "urp").resolve()
    assert first.script_network.value == "loopback"
    assert first.controller.encoder_speeds == (5.0, 0.0)
    assert second.controller.model.name == "ur10e"
    assert second.wanted_ports["rtde"] == 30011


@each_row(
    ("text", "problem"),
    [
        ("robots: [{model: ur4}]", "robot 1, 127.0.0.1: unknown robot model 'ur4'"),
        ("robots: [{}, {modell: ur3}]", "entry 2: unknown 'modell'; allowed are count, model,"),
        ("robots: [{speed: fast}]", "entry 1: speed must be a number, not text"),
        ("robots: [{programs: 5}]", "entry 1: programs must be a path, not 5"),
        ("robots: [{programs: nowhere}]", "nowhere is not a folder"),
        ("robots: [{script-network: some}]", "entry 1: script_network: unknown 'some'; allowed are"),
        ("robots: [{count: 0}]", "entry 1: count must be a whole number >= 1"),
        ("robots: [{count: 2, host: 127.0.0.9}]", "entry 1: 2 robots cannot share the host 127.0.0.9"),
        ("robots: [{host: 127.0.0.9}, {host: 127.0.0.9}]", "robots 1 and 2 both use dashboard port 29999"),
        ("robots: [{count: 200}, {count: 200}]", "has 400 robots: a fleet has 1 to 250"),
        ("robots: []", "has 0 robots: a fleet has 1 to 250"),
        ("robots: {model: ur3}", "robots must be a list, not a mapping"),
        ("robots: [5]", "robots[0] must be a mapping, not a whole number"),
        ("robots: [{5: 6}]", "a name in robots[0] must be text, not a whole number"),
        ("robots:\n  - model: ur3\n  speed: 1", "is not YAML"),
        ("", "fleet.yaml must be a mapping, not nothing"),
        ("[]", "fleet.yaml must be a mapping, not a list"),
        ("robot: []", "unknown 'robot'; allowed are robots"),
    ],
)
def test_errors_in_a_file_are_one_clear_line(tmp_path, text: str, problem: str) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    result = CliRunner().invoke(app, ["--fleet", str(path)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("ur-emulator: ")
    assert problem in result.stderr
    assert result.stderr.count("\n") == 1


@each_row(
    ("arguments", "problem"),
    [
        (["--model", "ur4"], "robot 1, 127.0.0.1: unknown robot model 'ur4'"),
        (["--fleet", "missing.yaml"], "cannot read missing.yaml: No such file"),
        (["--fleet", "missing.yaml", "--count", "3"], "leave out --count"),
        (["--first-host", "here"], "--first-host must be an address"),
        (["--first-host", "255.255.255.255", "--count", "2"], "--first-host must be an address"),
    ],
)
def test_errors_on_the_command_line_are_one_clear_line(arguments: list[str], problem: str) -> None:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert problem in result.stderr
    assert result.stderr.count("\n") == 1


@each_row("option", [["--host", "127.0.0.2"], ["--count", "0"], ["--processes", "0"], ["--count", "251"]])
def test_unsupported_options(option: list[str]) -> None:
    assert CliRunner().invoke(app, option).exit_code == 2


def test_processes_share_the_control_periods_evenly() -> None:
    cb3, e_series = {"model": "ur3"}, {"model": "ur5e"}  # 125 and 500 periods per second
    configs = place([cb3, e_series, cb3, cb3, cb3, e_series], configure, "127.0.0.1")
    assert share_out(configs, 3) == [(1,), (5,), (0, 2, 3, 4)]
    assert share_out(configs, 100) == [(1,), (5,), (0,), (2,), (3,), (4,)]


def test_a_single_host_is_checked(tmp_path) -> None:
    with pytest.raises(ConfigError, match="both use"):
        plan(tmp_path / "fleet.yaml", "robots: [{host: 127.0.0.1, port_offset: 1}, {host: 127.0.0.1, port_offset: 2}]")
