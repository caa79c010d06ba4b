"""Every dashboard command: its reply, its effect, and the versions that have it.

Reply texts: the reference tables of the dashboard manuals and of the official C++ client.
"""

import gzip
import re
import tempfile
import zipfile

import pytest

from emulator.commands import dashboard
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState, SafetyMode
from urproto.versions import PolyscopeVersion

MOVE = "def far():\n  movej([1.0, -1.0, 0.5, -1.0, 0.3, 0.2], a=1.0, v=0.5)\nend\n"
INSTALLATION = (
    '<Installation><TCPSettings activePose="TCP" toolPayload="0.5"><availablePoses>'
    '<tcp name="TCP" offset="0, 0, 0.2, 0, 0, 0"/></availablePoses></TCPSettings></Installation>'
)


@pytest.fixture
def programs(tmp_path):
    (tmp_path / "far.script").write_text(MOVE)
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "inner.script").write_text(MOVE)
    (tmp_path / "broken.txt").write_text("?")
    (tmp_path / "cell.installation").write_bytes(gzip.compress(INSTALLATION.encode()))
    (tmp_path / "bad.installation").write_bytes(b"?")
    return tmp_path


# replies without preparation: command, reply pattern on a CB3 that is off
SIMPLE = [
    ("running", "Program running: false"),
    ("robotmode", "Robotmode: POWER_OFF"),
    ("safetymode", "Safetymode: NORMAL"),
    ("safetystatus", "Safetystatus: NORMAL"),
    ("get loaded program", "No program loaded"),
    ("programState", "STOPPED null"),
    ("isProgramSaved", "true null"),
    ("stop", "Stopped"),
    ("play", "Failed to execute: play"),
    ("pause", "Failed to execute: pause"),
    ("popup hello there", "showing popup"),
    ("close popup", "closing popup"),
    ("close safety popup", "closing safety popup"),
    ("addToLog  some text ", "Added log message"),
    ("addToLog", "No log message to add"),
    ("setUserRole programmer", "Setting user role: programmer"),
    ("setUserRole boss", "Failed setting user role: boss"),
    ("getUserRole", "NONE"),
    ("PolyscopeVersion", r"URSoftware 3\.15\.8\.106339 \(Jun 20 2022\)"),
    ("get serial number", r"20\d+"),
    ("get robot model", "UR3"),
    ("power on", "Powering on"),
    ("power off", "Powering off"),
    ("brake release", "Brake releasing"),
    ("unlock protective stop", "Protective stop releasing"),
    ("restart safety", "Restarting safety"),
    ("load nothing.urp", "File not found: nothing.urp"),
    ("load installation nothing.installation", "File not found: nothing.installation"),
    ("saveLog", "Log saved to disk"),
    ("generate flight report system", r"Flight Report generated with id: 20\d+_\d+_system"),
    ("generate support file .", r"Completed successfully: ur_20\d+_[\d_-]+\.zip"),
    ("shutdown", "Shutting down"),
    ("quit", "Disconnected"),
]


@pytest.mark.parametrize(("line", "reply"), SIMPLE)
def test_reply_on_an_idle_cb3(rig, line, reply, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # reports without a programs directory
    assert re.fullmatch(reply, rig.request(line))


def test_without_a_programs_directory_reports_go_to_a_logged_folder(rig, tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    rig.request("saveLog")
    rig.request("generate flight report controller")
    rig.request("saveLog")
    (folder,) = tmp_path.iterdir()
    assert f"reports are written to {folder}" in (folder / "log_history.txt").read_text()
    assert len(list(folder.glob("flightreport_*_controller.txt"))) == 1


def test_every_cb3_command_is_in_the_table_above():
    lines = [line.lower() for line, _ in SIMPLE]
    for command in dashboard.available_commands(PolyscopeVersion(3, 15, 8)):
        assert any(
            line == command.form.words.lower() or line.startswith(command.form.words.lower() + " ") for line in lines
        )


def test_every_command_has_help():
    assert all(command.function.__doc__ for command in dashboard.COMMANDS.values())


@pytest.mark.parametrize("line", ["ROBOTMODE", "RobotMode", "  robotmode  ", "robotmode\r"])
def test_case_and_surrounding_space_do_not_matter(rig, line):
    assert rig.request(line) == "Robotmode: POWER_OFF"


@pytest.mark.parametrize("line", ["foo", "robotmode now", "loadx", "power", "is in remote control", "version", "\x00"])
def test_commands_unknown_to_a_cb3(rig, line):
    assert rig.request(line) == f"could not understand: '{line}'"


@pytest.mark.parametrize("line", ["", "   ", "\r"])
def test_empty_lines_have_no_reply(rig, line):
    assert rig.request(line) is None


E_SERIES = [
    ("is in remote control", "false"),
    ("version", r"5\.\d+\.\d+\.\d+"),
    ("get robot model", "UR5"),
    ("programState", "STOPPED <unnamed>"),
    ("get operational mode", "NONE"),
    ("set operational mode automatic", "Operational mode 'automatic' is set"),
    ("set operational mode sideways", "Failed setting operational mode: sideways"),
    ("clear operational mode", r"No longer controlling the operational mode\. Current operational mode: 'NONE'\."),
    ("setUserRole none", "could not understand: 'setUserRole none'"),
    ("getUserRole", "could not understand: 'getUserRole'"),
]


@each_row(("line", "reply"), E_SERIES)
def test_reply_on_an_e_series(make, line, reply):
    assert re.fullmatch(reply, make("ur5e").request(line))


# command, last version without it, first version with it
GATES = [
    ("safetystatus", "3.10.0", "3.11.0"),
    ("get robot model", "3.11.0", "3.12.0"),
    ("saveLog", "3.12.1", "3.13.0"),
    ("restart safety", "3.6.1", "3.7.0"),
    ("load installation x", "3.2.18000", "3.2.18654"),
    ("unlock protective stop", "3.0.0", "3.1.0"),
    ("safetystatus", "5.3.0", "5.4.0"),
    ("is in remote control", "5.5.1", "5.6.0"),
    ("get serial number", "5.5.1", "5.6.0"),
    ("generate support file .", "5.7.0", "5.8.0"),
    ("restart safety", "5.0.2", "5.1.0"),
    ("version", "5.12.0", "5.13.0"),
]


@each_row(("line", "without", "having"), GATES)
def test_version_gates(make, line, without, having):
    model = "ur3" if without.startswith("3") else "ur3e"
    refused = make(model, without).request(line)
    if line == "load installation x":  # older software interprets it as a program's name
        assert refused == "File not found: installation x"
    else:
        assert refused == f"could not understand: '{line}'"
    assert "understand" not in make(model, having).request(line)


def test_load_play_pause_stop(make, programs):
    rig = make(running=True, programs_dir=programs)
    assert rig.request("load far.script") == "Loading program: /programs/far.script"
    assert rig.request("get loaded program") == "Loaded program: /programs/far.script"
    assert rig.request("isProgramSaved") == "true far.script"
    assert rig.request("programState") == "STOPPED far.script"
    assert rig.request("play") == "Starting program"
    assert rig.now.runtime_state is RuntimeState.PLAYING
    assert rig.request("play") == "Failed to execute: play"
    assert rig.request("running") == "Program running: true"
    assert rig.request("programState") == "PLAYING far.script"
    assert rig.request("pause") == "Pausing program"
    assert rig.request("programState") == "PAUSED far.script"
    assert rig.request("running") == "Program running: false"
    assert rig.request("play") == "Starting program"
    assert rig.request("stop") == "Stopped"
    assert rig.request("running") == "Program running: false"
    assert rig.request("programState") == "STOPPED far.script"


@each_row(
    ("name", "shown"),
    [
        ("sub/inner.script", "/programs/sub/inner.script"),
        ("/programs/sub/inner.script", "/programs/sub/inner.script"),
        ("/ursim/programs/sub/inner.script", "/ursim/programs/sub/inner.script"),  # the official client searches for it
    ],
)
def test_programs_are_found_by_any_name_clients_use(make, programs, name, shown):
    assert make(programs_dir=programs).request(f"load {name}") == f"Loading program: {shown}"


@each_row("name", ["../secret.script", "/etc/passwd", "sub", ""])
def test_nothing_outside_the_programs_directory_is_loaded(make, programs, name):
    (programs.parent / "secret.script").write_text(MOVE)
    assert make(programs_dir=programs).request(f"load {name}").startswith("File not found:")


def test_a_file_that_is_not_a_program(make, programs):
    rig = make(programs_dir=programs)
    assert rig.request("load broken.txt") == "Error while loading program: broken.txt"
    assert rig.request("get loaded program") == "No program loaded"


def test_loading_stops_the_running_program(make, programs):
    rig = make(running=True, programs_dir=programs)
    rig.script(MOVE)
    rig.seconds(0.3)
    assert rig.request("load far.script").startswith("Loading program")
    assert rig.now.runtime_state is RuntimeState.STOPPED


def test_play_needs_released_brakes(make, programs):
    rig = make(programs_dir=programs)
    rig.request("load far.script")
    assert rig.request("play") == "Failed to execute: play"


def test_load_installation(make, programs):
    rig = make(programs_dir=programs)
    height = rig.now.actual_TCP_pose
    assert rig.request("load installation cell.installation") == "Loading installation: /programs/cell.installation"
    assert rig.now.payload == 0.5
    assert rig.now.tcp_offset == (0, 0, 0.2, 0, 0, 0)
    assert rig.now.actual_TCP_pose != height
    assert rig.request("load installation bad.installation") == "Failed to load installation: bad.installation"


def test_popups_open_and_close(rig):
    rig.request("popup mind the arm")
    assert [popup.text for popup in rig.controller.popups.shown] == ["mind the arm"]
    rig.request("close popup")
    assert rig.controller.popups.shown == []


def test_operational_mode_can_be_set_and_cleared(make):
    rig = make("ur5e")
    rig.request("set operational mode MANUAL")
    assert rig.request("get operational mode") == "MANUAL"
    rig.request("clear operational mode")
    assert rig.request("get operational mode") == "NONE"


@pytest.mark.parametrize("role", ["programmer", "OPERATOR", "none", "Locked", "restricted"])
def test_user_roles(rig, role):
    rig.request(f"setUserRole {role}")
    assert rig.request("getUserRole") == role.upper()


def test_log_and_reports_are_real_files(make, programs):
    rig = make(programs_dir=programs)
    rig.request("addToLog remember this")
    assert rig.request("saveLog") == "Log saved to disk"
    assert "remember this" in (programs / "log_history.txt").read_text()
    report = rig.request("generate flight report system")
    report_id = report.removeprefix("Flight Report generated with id: ")
    assert "UR3" in (programs / f"flightreport_{report_id}.txt").read_text()
    assert rig.request("generate flight report").startswith("Flight Report generated with id:")
    assert rig.request("generate flight report gossip").startswith(
        "Failed to generate flight report: unknown report 'gossip'"
    )
    answer = rig.request("generate support file sub")
    name = answer.removeprefix("Completed successfully: ")
    assert re.fullmatch(r"ur_\d+_2024-01-01_00-00-\d\d\.zip", name)
    with zipfile.ZipFile(programs / "sub" / name) as archive:
        assert f"flightreport_{report_id}.txt" in archive.namelist()
        assert "remember this" in archive.read("log_history.txt").decode()
    assert rig.request("generate support file ../..").startswith("Failed to generate support file:")


@each_row(
    ("seconds", "date"),
    [(0.0, "1970-01-01_00-00-00"), (951_782_399.0, "2000-02-28_23-59-59"), (951_782_400.0, "2000-02-29_00-00-00"),
     (1_735_689_599.5, "2024-12-31_23-59-59"), (4_107_542_400.0, "2100-03-01_00-00-00")],
)  # fmt: skip
def test_the_date_of_a_support_file(make, programs, seconds, date):
    rig = make("ur5e", programs_dir=programs, wall_clock_s=seconds)
    assert rig.request("generate support file .").endswith(f"_{date}.zip")


def test_shutdown_powers_off_and_requests_the_end_of_the_process(ready):
    ready.request("shutdown")
    assert ready.controller.shutdown_requested
    assert ready.now.robot_mode is RobotMode.POWER_OFF


def test_load_is_answered_once_the_program_is_loaded(make, programs):
    rig = make(programs_dir=programs, running=True)
    begun = rig.now.timestamp
    assert rig.request("load far.script", within_s=0.9).startswith("Loading program")  # drivers wait for a second
    assert rig.now.timestamp - begun > 0.3


@pytest.mark.parametrize(("model", "version"), [("ur5", "3.14"), ("ur5e", "5.9")])
def test_a_script_sent_0_7_s_after_brake_release_runs(make, programs, model, version):
    """The official C++ library's tests do this, and simulators allow it."""
    rig = make(model, version, programs_dir=programs, timings=None)
    rig.request("brake release")
    rig.seconds(0.7)
    rig.request("load far.script")
    rig.script("protective_stop()\n")
    rig.until(lambda now: now.safety_mode is SafetyMode.PROTECTIVE_STOP, within_s=1.0)
