"""The rules of the safety system as tables, by what a client sees: safety mode, power and program.

Sources: the manuals' sections on safety modes, stop categories and recovery; the vendor's error table. The board's own
tables are not consulted.
"""

from dataclasses import replace

import pytest

from emulator.safety.causes import Cause
from emulator.safety.conditions import SafetyDevice
from tests.commands import SetSafetyDevice, TripSafety
from tests.rows import each_row
from urproto.modes import JointMode, ReportLevel, RobotMode, RuntimeState, SafetyMode
from urproto.primary.messages import ErrorCodeMessage
from urproto.robots import load_model
from urproto.versions import Series
from urscript.polyscope.safety_configuration import factory_configuration

PROGRAM = "def slow():\n  movej([1.5, -1.0, 0.5, -1.0, 0.3, 0.2], a=3.0, v=0.1)\nend\n"
START = (0.0, -1.57, 0.0, -1.57, 0.0, 0.0)
SAFETY = {
    SafetyMode.NORMAL: "N",
    SafetyMode.REDUCED: "R",
    SafetyMode.PROTECTIVE_STOP: "P",
    SafetyMode.RECOVERY: "C",
    SafetyMode.SAFEGUARD_STOP: "S",
    SafetyMode.SYSTEM_EMERGENCY_STOP: "Y",
    SafetyMode.ROBOT_EMERGENCY_STOP: "E",
    SafetyMode.VIOLATION: "V",
    SafetyMode.FAULT: "F",
}
POWER = {RobotMode.RUNNING: "r", RobotMode.IDLE: "i", RobotMode.POWER_OFF: "o"}
RUN = {RuntimeState.PLAYING: "p", RuntimeState.PAUSED: "h", RuntimeState.STOPPED: "s"}


def device(which, active=True):
    return lambda rig: rig.controller.post(SetSafetyDevice(which, active))


def trip(cause):
    return lambda rig: rig.controller.post(TripSafety(cause))


def dashboard(line):
    return lambda rig: rig.request(line)


EVENTS = {
    "program sent": lambda rig: rig.script(PROGRAM),
    "protective": trip(Cause.PROGRAM),
    "unlock": lambda rig: rig.script("set unlock protective stop"),
    "violation": trip(Cause.JOINT_SPEED_VIOLATION),
    "fault": trip(Cause.SAFETY_FAULT),
    **{
        f"{name} {word}": device(which, active)
        for which, name in (
            (SafetyDevice.EMERGENCY_STOP, "emergency"),
            (SafetyDevice.SYSTEM_EMERGENCY_STOP, "system"),
            (SafetyDevice.SAFEGUARD, "safeguard"),
            (SafetyDevice.REDUCED_MODE, "reduced"),
        )
        for word, active in (("on", True), ("off", False))
    },
    **{
        line: dashboard(line)
        for line in ("restart safety", "play", "pause", "stop", "power off", "power on", "brake release")
    },
}

# Rows: events. Columns: what has happened to a playing program before. Cells: safety mode, robot mode, program, each by
# its letter; a dot where nothing changes. p: it moves on, h: paused, s: stopped.
RULES = """
                nothing  reduced  paused  protective  safeguard  emergency  system  violation  fault  power-off
before          Nrp      Rrp      Nrh     Prh         Srh        Eoh        Yoh     Vos        Fos    Nos
protective      Prh      Prh      Prh     .           Prh        .          .       .          .      Pos
unlock          .        .        .       Nrh         .          .          .       .          .      .
violation       Vos      Vos      Vos     Vos         Vos        Vos        Vos     .          .      Vos
fault           Fos      Fos      Fos     Fos         Fos        Fos        Fos     Fos        .      Fos
emergency-on    Eoh      Eoh      Eoh     Eoh         Eoh        .          .       .          .      Eos
emergency-off   .        .        .       .           .          Noh        .       .          .      .
system-on       Yoh      Yoh      Yoh     Yoh         Yoh        .          .       .          .      Yos
system-off      .        .        .       .           .          .          Noh     .          .      .
safeguard-on    Srh      Srh      Srh     .           .          .          .       .          .      Sos
safeguard-off   .        .        .       .           Nrp        .          .       .          .      .
reduced-on      Rrp      .        Rrh     .           .          .          .       .          .      Ros
reduced-off     .        Nrp      .       .           .          .          .       .          .      .
restart-safety  .        .        .       .           .          .          .       Nos        Nos    .
play            .        .        Nrp     .           .          .          .       .          .      .
pause           Nrh      Rrh      .       .           .          .          .       .          .      .
stop            Nrs      Rrs      Nrs     Prs         Srs        Eos        Yos     .          .      .
power-off       Nos      Ros      Nos     Pos         Sos        Eos        Yos     .          .      .
power-on        .        .        .       .           .          .          .       .          .      Nis
brake-release   .        .        .       .           .          .          .       .          .      Nrs
"""
BEFORE = {
    "reduced": ["reduced on"],
    "paused": ["pause"],
    "protective": ["protective"],
    "safeguard": ["safeguard on"],
    "emergency": ["emergency on"],
    "system": ["system on"],
    "violation": ["violation"],
    "fault": ["fault"],
    "power-off": ["power off"],
    "nothing": [],
}
_HEAD, (_, *_BEGIN), *_ROWS = (line.split() for line in RULES.strip().splitlines())
CASES = [
    (situation, begin, [(row[0].replace("-", " "), row[1 + column]) for row in _ROWS])
    for column, (situation, begin) in enumerate(zip(_HEAD, _BEGIN, strict=True))
]


def unwired(**limits):
    """The limits of a UR5 that comes from the factory, without inputs, and with other limits of normal mode."""
    configuration = factory_configuration(load_model("ur5"))
    return replace(configuration, inputs={}, normal=replace(configuration.normal, **limits))


def playing(make, *events):
    rig = make("ur5", running=True, initial_q=START, safety=unwired())
    rig.script(PROGRAM)
    rig.seconds(0.3)
    return after(rig, *events)


def after(rig, *events):
    for event in events:
        EVENTS[event](rig)
        rig.seconds(0.4)
    return rig


def shown(rig):
    """The three letters; the arm moves exactly while a program plays."""
    now = rig.now
    letters = SAFETY[now.safety_mode] + POWER[now.robot_mode] + RUN[now.runtime_state]
    assert any(now.actual_qd) is (letters[2] == "p"), letters
    assert now.robot_status_bits == (letters[1] != "o") + 2 * (letters[2] == "p")
    return letters


@each_row(("situation", "begin", "rows"), CASES, ids=[case[0] for case in CASES])
def test_rules(make, situation, begin, rows):
    """Events that change nothing follow each other on one robot; each of the others has its own."""
    rig = playing(make, *BEFORE[situation])
    assert shown(rig) == begin
    for event, expected in rows:
        if expected != ".":
            assert shown(playing(make, *BEFORE[situation], event)) == expected, event
        elif not event.endswith(" on"):  # a device that changes nothing now is remembered: see the sequences
            assert shown(after(rig, event)) == begin, event
        else:
            assert shown(after(playing(make, *BEFORE[situation]), event)) == begin, event


@each_row(
    ("events", "expected"),
    [
        # the safeguard resumes only what it has paused, and only if nothing else has happened to it
        (["safeguard on", "stop", "safeguard off"], "Nrs"),
        (["pause", "safeguard on", "safeguard off"], "Nrh"),
        (["safeguard on", "protective", "unlock", "safeguard off"], "Nrh"),
        (["safeguard on", "protective", "safeguard off", "unlock"], "Nrh"),
        (["safeguard on", "emergency on", "emergency off", "safeguard off"], "Noh"),
        (["safeguard on", "emergency on", "emergency off", "brake release", "safeguard off"], "Nrh"),
        (["safeguard on", "reduced on", "safeguard off"], "Rrp"),
        (["safeguard on", "safeguard off", "pause", "safeguard on", "safeguard off"], "Nrh"),
        (["safeguard on", "safeguard off", "safeguard on", "safeguard off"], "Nrp"),
        # remembered conditions: the strongest first
        (["protective", "safeguard on", "unlock", "safeguard off"], "Nrh"),
        (["protective", "safeguard on", "safeguard off", "unlock"], "Nrh"),
        (["protective", "reduced on", "unlock", "play"], "Rrp"),
        (["reduced on", "protective", "unlock", "reduced off"], "Nrh"),
        (["emergency on", "system on", "emergency off"], "Yoh"),
        (["system on", "emergency on", "system off"], "Eoh"),
        (["system on", "emergency on", "emergency off"], "Yoh"),
        (["system on", "emergency on", "system off", "emergency off"], "Noh"),
        (["violation", "emergency on", "restart safety"], "Eos"),
        (["fault", "safeguard on", "restart safety"], "Sos"),
        (["emergency on", "violation", "emergency off", "restart safety"], "Nos"),
        (["violation", "reduced on", "restart safety"], "Ros"),
        # recovery
        (["emergency on", "emergency off", "brake release", "play"], "Nrp"),
        (["fault", "restart safety", "brake release", "program sent"], "Nrp"),
        (["protective", "play", "unlock", "play"], "Nrp"),
        (["protective", "stop", "unlock", "program sent"], "Nrp"),
        (["protective", "power off", "brake release", "unlock"], "Nrs"),
        # a program that is sent to an arm that may not move waits; it replaces one that a safety stop has paused
        (["stop", "protective", "program sent"], "Prh"),
        (["protective", "program sent", "unlock", "play"], "Nrp"),
        (["stop", "safeguard on", "program sent", "safeguard off"], "Nrh"),
        (["power off", "program sent"], "Noh"),
        (["pause", "program sent", "program sent"], "Nrp"),
    ],
    ids=lambda value: value if isinstance(value, str) else ", ".join(value),
)
def test_sequences(make, events, expected):
    assert shown(playing(make, *events)) == expected


@each_row("events", [["protective", "unlock"], ["violation", "restart safety"], ["safeguard on"]])
def test_an_arm_without_power_is_not_supervised(make, events):
    """Outside its limits, it is in recovery mode only while it has power, and a stop that ends does not check them."""
    narrow = unwired(joint_max=(0.5, *unwired().normal.joint_max[1:]))
    rig = make("ur5", initial_q=(0.6, *START[1:]), safety=narrow)
    assert shown(after(rig, *events)) == ("Sos" if "safeguard on" in events else "Nos")
    assert shown(after(rig, "safeguard off")) == "Nos"
    assert shown(after(rig, "power on")) == "Cis"
    assert shown(after(rig, "brake release")) == "Crs"
    assert shown(after(rig, "protective", "unlock")) == "Crs"
    assert shown(after(rig, "safeguard on", "safeguard off")) == "Crs"
    assert shown(after(rig, "reduced on")) == "Crs"
    assert shown(after(rig, "power off")) == "Cos"


@each_row(
    ("cause", "joint", "argument", "at_fault"),
    [
        (Cause.JOINT_FAULT, None, 0, {0}),
        (Cause.JOINT_FAULT, 3, 3, {3}),
        (Cause.SAFETY_FAULT, None, 1, set()),
        (Cause.SAFETY_FAULT, 3, 1, {3}),
        (Cause.JOINT_SPEED_VIOLATION, None, 32, {0}),
    ],
)
def test_the_joint_at_fault(make, cause, joint, argument, at_fault):
    """A cause of one joint is that of the base unless another is named; the others may have none."""
    rig = make("ur5", running=True)
    rig.controller.post(TripSafety(cause, joint))
    rig.tick()
    assert [error.argument for error in rig.messages_of(ErrorCodeMessage)] == [argument]
    assert {index for index, mode in enumerate(rig.now.joint_mode) if mode is not JointMode.POWER_OFF} == at_fault
    rig.request("restart safety")
    assert rig.now.joint_mode == (JointMode.POWER_OFF,) * 6


# cause: code, lowest and highest argument, level, series (b: both)
CODES = """
JOINT_LIMIT               150  0-0    warning    b
TOOL_ORIENTATION          151  0-0    warning    b
SAFETY_PLANE              152  0-0    warning    b
PATH_DEVIATION            153  0-5    warning    b
COLLISION                 157  0-5    warning    b
ELBOW_PLANE               400  0-0    warning    e
CLAMPING                  403  0-0    warning    e
UNREACHABLE               204  3-3    warning    b
SINGULARITY               154  0-0    warning    b
WORLD_FAILURE             116  1-1    warning    b
PROGRAM                   209  0-0    warning    b
JOINT_POSITION_VIOLATION  191  1-1    violation  b
JOINT_SPEED_VIOLATION     191  32-37  violation  b
TCP_SPEED_VIOLATION       191  3-3    violation  b
TCP_POSITION_VIOLATION    191  4-4    violation  b
TCP_ORIENTATION_VIOLATION 191  5-5    violation  b
POWER_VIOLATION           191  6-6    violation  b
FORCE_VIOLATION           191  7-7    violation  b
MOMENTUM_VIOLATION        191  12-12  violation  b
ELBOW_SPEED_VIOLATION     191  3-3    violation  e
STOP_TIME_VIOLATION       191  16-16  violation  b
SAFETY_FAULT              192  1-1    fault      b
JOINT_FAULT               193  0-5    fault      b
POWER_LOSS                50   5-5    fault      b
STOP_COUNT                163  0-5    fault      b
EMULATOR_FAILURE          116  0-0    fault      b
"""
LEVELS = {
    "warning": (SafetyMode.PROTECTIVE_STOP, ReportLevel.WARNING, JointMode.RUNNING),
    "violation": (SafetyMode.VIOLATION, ReportLevel.VIOLATION, JointMode.VIOLATION),
    "fault": (SafetyMode.FAULT, ReportLevel.FAULT, JointMode.FAULT),
}


@pytest.mark.parametrize("model", ["ur5", "ur5e"])
def test_each_cause_reports_its_code_and_the_joint(make, model):
    rows = {name: rest for name, *rest in (line.split() for line in CODES.strip().splitlines())}
    assert set(rows) == {cause.name for cause in Cause if cause.value.code is not None}
    for name, (code, arguments, level, series) in rows.items():
        low, high = map(int, arguments.split("-"))
        mode, reported, joint_mode = LEVELS[level]
        rig, answers = make(model, running=True), []
        rig.controller.post(TripSafety(Cause[name], 5), answers.append)
        rig.tick()
        if series == "e" and rig.controller.model.series is Series.CB3:
            assert (answers, rig.now.safety_mode) == ([False], SafetyMode.NORMAL), name
            continue
        assert (answers, rig.now.safety_mode) == ([True], mode), name
        (error,) = rig.messages_of(ErrorCodeMessage)
        assert (error.code, error.argument, error.level) == (int(code), high, reported), name
        assert rig.now.joint_mode[5] is joint_mode, name
        assert Cause[name].value.label == f"C{code}A{low}" + (f"-{high}" if high > low else ""), name
