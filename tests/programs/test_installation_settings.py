"""Changed installation files: new values, unchanged contents, and effects on the robot."""

import gzip
from pathlib import Path

import pytest
from tree_rig import Arm, main, textmsg

from emulator.machine import ControllerConfig
from emulator.virtual import VirtualRobot
from tests.rows import each_row
from urproto.controlapi import BadArguments
from urproto.robots import load_model
from urproto.signals import STANDARD
from urproto.versions import DEFAULT_VERSION, Series
from urscript.polyscope.document import read_document, write_document
from urscript.polyscope.installation_file import load_installation_file, read_installation
from urscript.polyscope.installation_sections import SettingError
from urscript.polyscope.installation_settings import (
    SECTIONS,
    add_setting,
    change_setting,
    new_installation,
    read_settings,
    remove_setting,
)
from urscript.polyscope.numbers import double_text
from urscript.polyscope.safety_settings import SAFETY_SECTIONS

PAYLOAD = (
    '<Payload name="{}" mass="0.5" defaultPayload="{}" centerOfGravity="0.0, 0.0, 0.02" '
    'inertiaParameters="0.0, 0.0, 0.0, 0.0, 0.0, 0.0" customInertiaEnabled="false"/>'
)
POINT = """\
    <GeomPoseNode>
      <GeomPoseNode showAxes="true" joggable="true" isVariable="true" id="7" name="table">
        <jointPositionVector value="0.1, 0.2, 0.3, 0.4, 0.5, 0.6"/>
        <toolPosition value="0.1, 0.2, 0.3"/>
        <toolAxisAngle value="0.0, 3.0, 0.0"/>
      </GeomPoseNode>
    </GeomPoseNode>
"""


def saved(series: str) -> str:
    """An installation in the form of PolyScope 5.14 or 3.15, with an unknown URCap and more."""
    old = series == "cb3"
    payload = (
        ""
        if old
        else f"""
  <PayloadSettings>
    {PAYLOAD.format("empty", "true")}
    {PAYLOAD.format("full", "false")}
  </PayloadSettings>"""
    )
    return f"""\
<Installation directory="/programs" fileName="cell &quot;1&quot;" showSpeedSliderOnRunTab="false">
  <IOs>
    <DigitalInputNames value="gate, , , , , , , "/>
    <DigitalOutputNames value=", , , , , , , "/>
    <DigitalInputActions value="START, NONE, NONE, NONE, NONE, NONE, NONE, NONE"/>
    <DigitalOutputActions value="NONE, NONE, NONE, NONE, NONE, NONE, NONE, NONE"/>
    <ModbusUnits>
      <Unit ipAddress="10.0.0.9" sequentialMode="false">
        <ModbusSignal class="ModbusSignal" name="lamp" type="DIGITAL_OUTPUT" slaveAddress="255" updateFrequency="10" \
signalAddress="16" loadTestString="Signal created" inputAction="NONE"/>
      </Unit>
    </ModbusUnits>
  </IOs>
  <Version major="{3 if old else 5}" minor="14" bugfix="5"/>
  <LastSavedInVersion reference="../Version"/>
  <DefaultProgramSettings autoLoad="false"/>
  <TCPSettings activePose="TCP"{' toolPayload="0.0"' if old else ""}>
    <availablePoses>
      <tcp id="5" name="TCP" offset="0.0, 0.0, 0.0, 0.0, 0.0, 0.0"/>
      <tcp id="6" name="hand" offset="-4.516483728619642E-6, 0.0, 0.15, 0.0, 0.0, 1.0"/>
    </availablePoses>
  </TCPSettings>{payload}
  <Features>
    <CameraView>
      <worldTransform class="WorldTransform">
        <WorldtoMarshal showAxes="false" isVariable="false" baseAngle="0.0" tiltAngle="0.0"/>
      </worldTransform>
    </CameraView>
{POINT}  </Features>
  <SafetySettings>
[Safety Checksum]
version = 5.8
crc = 2384686873
</SafetySettings>
  <Contributions>
    <URCaps>
      <Contributed ownerId="org.example" id="gripper" vendor="Somebody" name="A gripper">
        <data key="note" value="a &lt;b&gt; &amp; &apos;c&apos;&#xa;d"/>
      </Contributed>
    </URCaps>
  </Contributions>
</Installation>"""


both_series = pytest.mark.parametrize("series", ["cb3", "e"])


@both_series
@each_row(
    ("change", "before", "after"),
    [
        (
            lambda root: change_setting(root, "tcps", "hand", {"pose": [0.0, 0.0, 0.2, 0.0, 0.0, 1e-4]}),
            'offset="-4.516483728619642E-6, 0.0, 0.15, 0.0, 0.0, 1.0"',
            'offset="0.0, 0.0, 0.2, 0.0, 0.0, 1.0E-4"',
        ),
        (lambda root: change_setting(root, "tcps", "hand", {"active": True}), 'activePose="TCP"', 'activePose="hand"'),
        (lambda root: change_setting(root, "mounting", "", {"tilt": 3.0}), 'tiltAngle="0.0"', 'tiltAngle="3.0"'),
        (
            lambda root: change_setting(root, "io", "digital_out[2]", {"name": "lamp on"}),
            'OutputNames value=", , , ',
            'OutputNames value=", , lamp on, ',
        ),
        (
            lambda root: change_setting(root, "io", "digital_in[1]", {"action": "FREEDRIVE"}),
            '"START, NONE, ',
            '"START, FREEDRIVE, ',
        ),
        (
            lambda root: change_setting(root, "modbus", "lamp", {"register": 17}),
            'signalAddress="16"',
            'signalAddress="17"',
        ),
        (lambda root: change_setting(root, "modbus", "lamp", {"frequency": "2"}), 'Frequency="10"', 'Frequency="2"'),
        (
            lambda root: change_setting(root, "features", "table", {"variable": False}),
            'isVariable="true" id="7"',
            'isVariable="false" id="7"',
        ),
        (
            lambda root: change_setting(
                root, "default_program", "", {"file": "a.urp", "load": True, "start_pin": "gate"}
            ),
            '<DefaultProgramSettings autoLoad="false"/>',
            '<DefaultProgramSettings fileName="a.urp" autoLoad="true" nameOfSensorToAutoStartProgram="gate" '
            'triggerValueToStartProgram="false"/>',
        ),
        (
            lambda root: change_setting(root, "external_control", "", {"host": "10.1.1.1"}),
            "      </Contributed>\n    </URCaps>",
            "      </Contributed>\n"
            '      <Contributed ownerId="com.fzi.externalcontrol" '
            'id="com.fzi.externalcontrol.impl.ExternalControlInstallationNodeService" '
            'installationContributionTitle="External Control" vendor="FZI Research Center for Information Technology" '
            'name="External Control">\n'
            '        <data key="host_ip" value="10.1.1.1"/>\n        <data key="name" value="10.1.1.1"/>\n'
            "      </Contributed>\n    </URCaps>",
        ),
        (lambda root: remove_setting(root, "features", "table"), POINT, ""),
        (
            lambda root: remove_setting(root, "tcps", "hand"),
            '      <tcp id="6" name="hand" offset="-4.516483728619642E-6, 0.0, 0.15, 0.0, 0.0, 1.0"/>\n',
            "",
        ),
        (
            lambda root: change_setting(root, "tcps", "hand", {"pose": [-4.516483728619642e-6, 0, 0.15, 0, 0, 1]}),
            "",
            "",
        ),
    ],
)
def test_nothing_but_the_changed_value_changes_in_the_file(series, change, before, after):
    text = saved(series)
    assert before in text
    root = read_document(text.encode())
    assert write_document(root).decode() == text
    change(root)
    assert write_document(root).decode() == text.replace(before, after, 1)


def test_the_payload_is_stored_as_on_the_series():
    cb3, e = (read_document(saved(series).encode()) for series in ("cb3", "e"))
    change_setting(cb3, "payloads", "Payload", {"mass": 1.5, "cog": [0.0, 0.0, 0.03]})
    assert 'toolPayload="1.5" centerOfGravity="0.0, 0.0, 0.03"' in write_document(cb3).decode()
    with pytest.raises(SettingError, match="can contain only one payload"):
        add_setting(cb3, "payloads", {"name": "more", "mass": 1.0, "cog": [0.0, 0.0, 0.0]})
    change_setting(e, "payloads", "full", {"default": True})
    assert read_installation(write_document(e), "x").payloads.keys() == {"empty", "full"}
    assert [row["default"] for row in read_settings(e)["payloads"]] == [False, True]
    add_setting(e, "payloads", {"name": "more", "mass": 1.25, "cog": [0.0, 0.01, 0.0], "default": True})
    assert read_installation(write_document(e), "x").payload.mass == 1.25


@both_series
def test_added_entries_are_read_back(series):
    root = read_document(saved(series).encode())
    add_setting(root, "tcps", {"name": "pen", "pose": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0], "active": True})
    add_setting(root, "features", {"name": "shelf", "pose": [0.4, 0.0, 0.5, 0.0, 0.0, 0.0], "variable": True})
    signal = {
        "name": "belt",
        "address": "10.0.0.8",
        "type": "REGISTER_INPUT",
        "register": 128,
        "slave": 1,
        "frequency": "5",
    }
    add_setting(root, "modbus", signal)
    change_setting(root, "modbus", "lamp", {"address": "10.0.0.8"})
    change_setting(root, "features", "table", {"pose": [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], "name": "desk"})
    file = read_installation(write_document(root), "x")
    assert file.tcp == (0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    assert file.features["shelf"][:3] == (0.4, 0.0, 0.5)
    assert file.features["desk"][0] == 0.5
    assert file.feature_variables == {"shelf", "desk"}
    assert {(signal.name, signal.address, signal.type) for signal in file.modbus} == {
        ("belt", "10.0.0.8", 2),
        ("lamp", "10.0.0.8", 1),
    }
    remove_setting(root, "modbus", "lamp")
    remove_setting(root, "modbus", "belt")
    assert read_settings(root)["modbus"] == []


@each_row(
    ("section", "name", "values", "complaint"),
    [
        ("tcps", "hand", {"pose": [1.0, 2.0]}, "must be 6 numbers"),
        ("tcps", "hand", {"pose": [0, 0, 99.0, 0, 0, 0]}, "between -10 and 10 m"),
        ("tcps", "hand", {"name": "TCP"}, "there is already a 'TCP'"),
        ("tcps", "TCP", {"active": False}, "make another TCP active"),
        ("tcps", "claw", {"pose": [0] * 6}, "there is no 'claw': there are TCP, hand"),
        ("tcps", "hand", {"colour": "red"}, "has no setting 'colour'"),
        ("payloads", "full", {"mass": -1.0}, "between 0 and 100 kg"),
        ("payloads", "full", {"mass": float("nan")}, "must be a number"),
        ("features", "table", {"kind": "plane"}, "has no setting 'kind' that can be changed"),
        ("io", "digital_in[1]", {"action": "STOP"}, "it can have NONE, FREEDRIVE"),
        ("io", "digital_in[1]", {"name": "a, b"}, "commas"),
        ("io", "digital_in[1]", {"name": "gate"}, r"digital_in\[0\] is already called 'gate'"),
        ("modbus", "lamp", {"type": "COIL"}, "must be one of DIGITAL_INPUT"),
        ("modbus", "lamp", {"register": 1.5}, "a whole number"),
        ("modbus", "lamp", {"address": "some where"}, "not the address of a Modbus unit"),
        ("external_control", "", {"host": ""}, "is not a host"),
        ("external_control", "", {"port": 0}, "between 1 and 65535"),
        ("default_program", "", {"load": True}, "give its path"),
        ("default_program", "", {"file": "a.urp", "start_pin": "analog_in[0]"}, "not a digital input"),
        ("colours", "", {}, "no section 'colours'"),
    ],
)
def test_invalid_values_are_refused_by_name_and_change_nothing(section, name, values, complaint):
    root = read_document(saved("e").encode())
    with pytest.raises(SettingError, match=complaint):
        change_setting(root, section, name, values)
    assert write_document(root).decode() == saved("e")


def test_numbers_are_formatted_as_in_java():
    written = {0.0: "0.0", -0.25: "-0.25", 0.001: "0.001", 1.4e-4: "1.4E-4", 2e-5: "2.0E-5", 1e7: "1.0E7", 3: "3.0"}
    assert {value: double_text(value) for value in written} == written


@pytest.mark.parametrize("series", list(Series)[:2])
def test_a_new_installation_has_all_sections(series):
    root = read_document(write_document(new_installation(DEFAULT_VERSION[series])))
    rows = read_settings(root)
    assert [name for name in SECTIONS if not rows[name]] == [
        *("features", "modbus"),
        *(section.name for section in SAFETY_SECTIONS),
    ]
    assert len(rows["payloads"]) == 1
    assert read_installation(write_document(root), "x").gravity == (0.0, 0.0, 9.82)


# on an emulated robot


def robot(folder: Path | None, model: str) -> VirtualRobot:
    return VirtualRobot(ControllerConfig(model=load_model(model), running=True, programs_dir=folder))


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_the_drivers_address_survives_a_restart(tmp_path, model):
    before = robot(tmp_path, model)
    before.set_external_control("10.0.0.1")
    before.change_installation("external_control", {"host": "192.168.56.7"})
    assert before.external_control() == {"host": "192.168.56.7", "port": 50002}
    before.change_installation("external_control", {"port": 50102})
    assert [path.name for path in tmp_path.iterdir()] == ["default.installation"]
    after = robot(tmp_path, model)
    assert after.external_control() == {"host": "192.168.56.7", "port": 50102}
    assert after.installation("external_control")["sections"] == {
        "external_control": [{"host": "192.168.56.7", "port": 50102}]
    }


def test_only_tool_and_mounting_take_effect_immediately(tmp_path):
    (tmp_path / "default.installation").write_bytes(gzip.compress(saved("e").encode()))
    arm = robot(tmp_path, "ur5e")
    arm.set_tcp((0.0, 0.0, 0.05, 0.0, 0.0, 0.0))
    arm.change_installation("io", {"name": "gripper"}, "digital_out[0]")
    arm.change_installation("tcps", {"pose": [0, 0, 0.3, 0, 0, 0]}, "hand")
    arm.step()
    assert arm.state(["tcp_offset"])["tcp_offset"][2] == 0.05
    arm.change_installation("tcps", {"active": True}, "hand")
    arm.change_installation("payloads", {"default": True}, "full")
    arm.change_installation("mounting", {"tilt": 3.141592653589793})
    arm.step()
    state = arm.state(["tcp_offset", "payload", "target_gravity"])
    assert state["tcp_offset"][2] == 0.3
    assert state["payload"] == 0.5
    assert state["target_gravity"][2] == pytest.approx(-9.82)
    assert arm.installation()["file"] == "default.installation"


def test_refusals_state_the_reason_and_leave_the_file_unchanged(tmp_path):
    path = tmp_path / "default.installation"
    path.write_bytes(gzip.compress(saved("e").encode()))
    arm, before = robot(tmp_path, "ur5e"), path.read_bytes()
    for section, values, complaint in (
        ("safety_limits", {"normal": 1000.0}, "safety settings cannot be read"),
        ("default_program", {"file": "none.urp"}, "no program none.urp in the programs folder"),
    ):
        with pytest.raises(BadArguments, match=complaint):
            arm.change_installation(section, values, "TCP force [N]")
    assert path.read_bytes() == before


def test_without_a_folder_an_installation_is_saved_to_a_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    arm = robot(None, "ur5e")
    arm.change_installation("mounting", {"tilt": 1.0})
    assert "--programs" in arm.log()[0]
    (saved_to,) = tmp_path.rglob("default.installation")
    assert load_installation_file(saved_to).gravity[1] != 0.0


def test_signal_actions_apply_from_the_next_program(tmp_path):
    root = read_document(saved("e").encode())
    change_setting(root, "io", "digital_out[3]", {"action": "LOW_WHEN_PROGRAM_STOPPED"})
    change_setting(root, "io", "digital_in[1]", {"action": "FREEDRIVE"})
    (tmp_path / "default.installation").write_bytes(gzip.compress(write_document(root)))
    arm = Arm(tmp_path)
    arm.save("it.urp", main(textmsg("here")))
    arm.controller.signals.set_digital_output(STANDARD, 3, True)
    arm.request("load it.urp")
    arm.request("play")
    arm.until(lambda: "here" in arm.texts, 5.0)
    arm.until(lambda: not arm.controller.signals.get_digital_output(STANDARD, 3), 5.0)
    arm.controller.signals.set_digital_input(STANDARD, 1, True)
    arm.until(lambda: arm.controller.freedrive_inputs.free, 5.0)
