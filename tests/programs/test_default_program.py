"""The default program: loading at boot, and inputs that release the brakes and start it."""

import gzip
from pathlib import Path

import pytest
from tree_rig import Arm, installation, main, sleep, tag, textmsg

from emulator.lifecycle.power import PowerTimings
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState
from urproto.signals import CONFIGURABLE, STANDARD

both_series = pytest.mark.parametrize("model", ["ur5", "ur5e"])
TCP = '<tcp name="TCP" offset="0, 0, 0.1, 0, 0, 0"/>'
NONE = "Loaded program: /programs/<unnamed>.urp"  # e-Series
QUICK = PowerTimings(joint_boot_s=0.02, power_on_s=0.02, brake_release_s=0.02)
CUBE = "Loaded program: /programs/cube/Cube.urp"


def settings(name: str = "cube/Cube.urp", load: bool = True, **inputs: tuple[str, bool]) -> str:
    """The settings that PolyScope writes; release, start: the input and the level."""
    attributes = {"fileName": name, "autoLoad": str(load).lower()}
    for key, (sensor, level) in {
        "release": ("nameOfSensorToInitialize", "triggerValueToInitialize"),
        "start": ("nameOfSensorToAutoStartProgram", "triggerValueToStartProgram"),
    }.items():
        if key in inputs:
            attributes |= {sensor: inputs[key][0], level: str(inputs[key][1]).lower()}
    return tag("DefaultProgramSettings", **attributes)


class Box(Arm):
    """A controller that is off, with these settings in its default.installation. high: inputs that are high at
    start."""

    def __init__(self, folder: Path, model: str, *default: str, high: tuple[int, ...] = (), **config) -> None:
        self.install(folder, *default)
        self.folder, self.high = folder, high
        self.save("cube/Cube.urp", main(textmsg("cube"), sleep(0.1)))
        self.save("other.urp", main(textmsg("other")))
        super().__init__(folder, model, running=False, **{"timings": QUICK, **config})

    def tick(self) -> None:
        for index in self.high:
            self.drive(index, True)
        self.high = ()
        super().tick()

    @staticmethod
    def install(folder: Path, *settings: str, name: str = "default") -> None:
        (folder / f"{name}.installation").write_bytes(gzip.compress(installation(*settings, tcps=TCP).encode()))

    def drive(self, index: int, level: bool, group=STANDARD) -> None:
        self.controller.signals.set_digital_input(group, index, level)

    @property
    def mode(self) -> RobotMode:
        return self.controller.snapshot.robot_mode

    @property
    def loaded(self) -> str:
        return self.request("get loaded program")

    @property
    def runs(self) -> int:
        return self.texts.count("cube")

    def release(self) -> None:
        self.request("brake release")
        self.until(lambda: self.mode is RobotMode.RUNNING, 1.0)

    def pulse(self, index: int = 0) -> None:
        for level in (True, False):
            self.drive(index, level)
            self.seconds(0.05)


@both_series
def test_a_controller_boots_with_its_installation_and_default_program(tmp_path, model):
    box = Box(tmp_path, model, settings())
    assert box.controller.snapshot.actual_TCP_pose == pytest.approx(box.controller.arm.tcp_pose)
    assert box.controller.installation.tcp[2] == 0.1
    assert box.loaded == CUBE
    assert box.request("programState") == "STOPPED Cube.urp"
    box.release()
    assert box.request("play") == "Starting program"
    box.until(lambda: box.runs)


def test_a_disabled_default_program_is_not_loaded(tmp_path):
    box = Box(tmp_path, "ur5e", settings(load=False))
    assert box.controller.installation.tcp[2] == 0.1
    assert box.loaded == NONE


def test_without_an_installation_nothing_happens(tmp_path):
    assert Arm(tmp_path).request("get loaded program") == NONE
    assert Arm(tmp_path).controller.messages.history == Arm(tmp_path / "none").controller.messages.history


@pytest.mark.parametrize(
    ("name", "content", "note"),
    [
        ("gone.urp", b"", "the default program gone.urp of default.installation is not in the programs folder"),
        ("../outside.urp", b"", "the default program ../outside.urp of default.installation is not in the programs"),
        ("bad.urp", b"\x1f\x8b?", "loading the default program bad.urp failed: "),
        ("bad.txt", b"hello", "loading the default program bad.txt failed: bad.txt is not a program"),
    ],
)
def test_an_unloadable_default_program_is_logged(tmp_path, name, content, note):
    folder = tmp_path / "programs"
    folder.mkdir()
    (tmp_path / "outside.urp").write_bytes(b"?")
    if content:
        (folder / name).write_bytes(content)
    box = Box(folder, "ur5e", settings(name))
    assert [note in line for line in box.controller.messages.history].count(True) == 1
    assert len(box.controller.messages.history) == 1
    assert box.loaded == NONE
    assert box.controller.installation.tcp[2] == 0.1


@pytest.mark.parametrize("content", [b"", b"?", b"\x1f\x8b", b"<Installation/>", b"<URProgram/>", "directory"])
def test_an_unreadable_installation_is_logged(tmp_path, content):
    path = tmp_path / "default.installation"
    if isinstance(content, bytes):
        path.write_bytes(content)
        box = Arm(tmp_path)
        assert len(box.controller.messages.history) == 1
        assert "default.installation cannot be used: " in box.controller.messages.history[0]
    else:
        path.mkdir()
        box = Arm(tmp_path)
    assert box.request("get loaded program") == NONE
    assert box.controller.installation.tcp[2] == 0.0


@both_series
@each_row("level", [True, False])
def test_an_edge_of_an_input_switches_the_arm_on(tmp_path, model, level):
    box = Box(tmp_path, model, settings(release=("digital_in[3]", level)), high=() if level else (3,))
    box.seconds(0.5)
    box.drive(4, level)
    box.seconds(0.5)
    assert box.mode is RobotMode.POWER_OFF
    box.drive(3, level)
    box.until(lambda: box.mode is RobotMode.RUNNING, 1.0)
    box.request("power off")
    box.seconds(0.5)  # a level is not an edge
    assert box.mode is RobotMode.POWER_OFF


@both_series
def test_an_edge_starts_the_program_each_time(tmp_path, model):
    box = Box(tmp_path, model, settings(start=("digital_in[0]", True)))
    box.pulse()
    box.release()
    box.seconds(0.5)
    assert box.runs == 0  # the arm was not ready at the edge
    for count in (1, 2):
        box.pulse()
        box.until(lambda count=count: box.runs == count and box.state is RuntimeState.STOPPED, 5.0)
    box.drive(0, True)
    box.seconds(0.5)
    assert box.runs == 3  # and only once, regardless of how long it is high


@both_series
@each_row("level", [True, False])
def test_a_level_present_at_boot_is_sufficient(tmp_path, model, level):
    """The manual's warning: no edge is needed then, and inputs are low by themselves."""
    both = ("digital_in[2]", level)
    box = Box(tmp_path, model, settings(release=both, start=both), high=(2,) if level else ())
    box.until(lambda: box.runs == 1, 2.0)
    box.seconds(0.5)
    assert box.runs == 1


def test_after_stop_the_input_does_not_start_the_program_until_play(tmp_path):
    box = Box(tmp_path, "ur5e", settings(start=("digital_in[0]", True)))
    box.release()
    box.seconds(0.1)
    box.drive(0, True)
    box.until(lambda: box.state is RuntimeState.PLAYING, 1.0)
    box.request("stop")
    box.drive(0, False)
    box.seconds(0.1)
    box.pulse()
    box.seconds(0.5)
    assert box.runs == 1
    box.request("play")
    box.until(lambda: box.runs == 2 and box.state is RuntimeState.STOPPED, 5.0)
    box.pulse()
    box.until(lambda: box.runs == 3, 5.0)


def test_only_the_default_program_is_started(tmp_path):
    box = Box(tmp_path, "ur5e", settings(load=False, start=("digital_in[0]", True)))
    box.release()
    box.pulse()
    box.request("load other.urp")
    box.pulse()
    box.seconds(0.5)
    assert box.texts == []
    box.request("load cube/Cube.urp")
    box.seconds(0.1)
    box.pulse()
    box.until(lambda: box.texts == ["cube"], 5.0)


@pytest.mark.parametrize("remote", [False, True])
def test_inputs_require_remote_control_only_if_enforced(tmp_path, remote):
    box = Box(
        tmp_path,
        "ur5e",
        settings(release=("digital_in[3]", True), start=("digital_in[0]", True)),
        remote_control=remote,
        enforce_remote_control=True,
    )
    box.seconds(0.1)
    box.drive(3, True)
    box.seconds(0.5)
    assert (box.mode is RobotMode.RUNNING) is remote
    box.release()
    box.seconds(0.1)
    box.pulse()
    box.seconds(0.5)
    assert box.runs == (1 if remote else 0)


def test_the_input_may_have_a_name_or_be_a_register(tmp_path):
    names = tag("IOs", tag("ConfigurableInputNames", value=",,go,,,,,"))
    box = Box(tmp_path, "ur5e", names, settings(release=("GP_bool_in[5]", True), start=("go", True)))
    box.seconds(0.1)
    box.controller.registers.input.set_bit(5, True)
    box.until(lambda: box.mode is RobotMode.RUNNING, 1.0)
    box.seconds(0.1)
    box.drive(2, True, CONFIGURABLE)
    box.until(lambda: box.runs == 1, 1.0)


@each_row("pin", ["digital_in[8]", "analog_in[0]", "digital_out[0]", "nothing"])
def test_an_invalid_input_is_logged(tmp_path, pin):
    box = Box(tmp_path, "ur5e", settings(release=(pin, False)))
    box.seconds(0.5)
    assert box.mode is RobotMode.POWER_OFF
    assert len([line for line in box.controller.messages.history if f"{pin} is not a digital input" in line]) == 1


def test_another_installation_starts_with_the_current_level_of_its_input(tmp_path):
    box = Box(tmp_path, "ur5e", settings(), high=(1,))
    Box.install(tmp_path, settings(release=("digital_in[1]", True)), name="second")
    box.request("load installation second.installation")
    box.seconds(0.5)
    assert box.mode is RobotMode.POWER_OFF
    box.drive(1, False)
    box.seconds(0.1)
    box.drive(1, True)
    box.until(lambda: box.mode is RobotMode.RUNNING, 1.0)


def test_a_slowly_booting_controller_loads_during_boot(tmp_path):
    box = Box(tmp_path, "ur5e", settings(), timings=PowerTimings(controller_boot_s=0.5))
    assert box.mode is RobotMode.BOOTING
    box.until(lambda: box.loaded == CUBE, 0.5)
    assert box.mode is RobotMode.BOOTING


def test_a_program_loaded_by_a_client_during_boot_is_kept(tmp_path):
    box = Box(tmp_path, "ur5e")
    box.save("long.urp", main(*(textmsg(f"line {number}") for number in range(1000))))
    Box.install(tmp_path, settings("long.urp"))
    rebooted = Arm(tmp_path, running=False, timings=PowerTimings(controller_boot_s=0.1))
    assert rebooted.request("load other.urp").startswith("Loading program")
    rebooted.seconds(3.0)
    assert rebooted.request("get loaded program") == "Loaded program: /programs/other.urp"
    assert Arm(tmp_path).request("get loaded program") == "Loaded program: /programs/long.urp"
