"""Every state against every event, for the tables of power, safety and program state.

The matrices below are written from the transition table of the reference notes, not from the code: one row per state,
one column per event, a dot where nothing changes.
"""

from emulator.lifecycle.power import POWER_TABLE, REPORTS, Power, PowerEvent, PowerState, PowerTimings
from emulator.lifecycle.runstate import RUN_TABLE, RunEvent, is_running, next_run_state
from emulator.lifecycle.safety import SAFETY_TABLE, Safety, SafetyEvent
from tests.rows import each_row
from urproto.modes import RobotMode, RuntimeState, SafetyMode, SafetyStatus, SafetyStatusBits

POWER = """
                    POWER_ON  BRAKE_RELEASE  POWER_OFF  CONFIRM  TIMEOUT
DISCONNECTED        .         .              .          .        CONTROLLER_BOOTING
CONTROLLER_BOOTING  .         .              .          .        OFF
UNCONFIRMED         BOOTING   BOOTING        .          OFF      OFF
OFF                 BOOTING   BOOTING        .          .        .
BOOTING             .         .              OFF        .        POWERED
POWERED             .         .              OFF        .        IDLE
IDLE                .         RELEASING      OFF        .        .
RELEASING           .         .              OFF        .        RUNNING
RUNNING             .         .              OFF        .        .
"""

RUN = """
          START    PAUSE    RESUME    STOP      FINISH    SETTLED
STOPPED   PLAYING  .        .         .         .         .
PLAYING   .        PAUSING  .         STOPPING  STOPPING  .
PAUSING   .        .        RESUMING  STOPPING  STOPPING  PAUSED
PAUSED    .        .        RESUMING  STOPPING  .         .
RESUMING  .        PAUSING  .         STOPPING  STOPPING  PLAYING
STOPPING  .        .        .         .         .         STOPPED
"""

# N normal, R reduced, P protective stop, C recovery, S safeguard stop,
# Y system emergency stop, E robot emergency stop, V violation, F fault
SAFETY_LETTERS = dict(
    zip(
        "NRPCSYEVF",
        (
            "NORMAL",
            "REDUCED",
            "PROTECTIVE_STOP",
            "RECOVERY",
            "SAFEGUARD_STOP",
            "SYSTEM_EMERGENCY_STOP",
            "ROBOT_EMERGENCY_STOP",
            "VIOLATION",
            "FAULT",
        ),
        strict=True,
    )
)
SAFETY = """
                         N R P C S Y E V F
PROTECTIVE_STOP          P P . P P . . . .
UNLOCK                   . . N . . . . . .
ROBOT_EMERGENCY_STOP     E E E E E . . . .
SYSTEM_EMERGENCY_STOP    Y Y Y Y Y . . . .
EMERGENCY_STOP_RELEASED  . . . . . N N . .
SAFEGUARD_OPEN           S S . S . . . . .
SAFEGUARD_CLOSED         . . . . N . . . .
AUTOMATIC_SAFEGUARD_OPEN   S S . S . . . . .
AUTOMATIC_SAFEGUARD_CLOSED . . . . N . . . .
ENABLING_RELEASED        S S . S . . . . .
ENABLING_HELD            . . . . N . . . .
OUTSIDE_LIMITS           C C . . . . . . .
INSIDE_LIMITS            . . . N . . . . .
REDUCED                  R . . . . . . . .
NOT_REDUCED              . N . . . . . . .
VIOLATION                V V V V V V V . .
FAULT                    F F F F F F F F .
RESTART                  . . . . . . . N N
"""


def matrix(text):
    head, *rows = (line.split() for line in text.strip().splitlines())
    return {(row[0], column): cell for row in rows for column, cell in zip(head, row[1:], strict=True)}


def test_power_table_is_complete():
    expected = matrix(POWER)
    assert len(expected) == len(PowerState) * len(PowerEvent)
    for (state, event), after in expected.items():
        pair = (PowerState[state], PowerEvent[event])
        assert POWER_TABLE.get(pair, pair[0]) is (pair[0] if after == "." else PowerState[after]), pair


def test_run_table_is_complete():
    expected = matrix(RUN)
    assert len(expected) == len(RuntimeState) * len(RunEvent)
    for (state, event), after in expected.items():
        pair = (RuntimeState[state], RunEvent[event])
        assert next_run_state(*pair) is (pair[0] if after == "." else RuntimeState[after]), pair
    assert set(RUN_TABLE) == {
        (RuntimeState[state], RunEvent[event]) for (state, event), after in expected.items() if after != "."
    }


@each_row("event", SafetyEvent)
@each_row("mode", [SafetyMode[name] for name in SAFETY_LETTERS.values()])
def test_safety_table(mode, event):
    letter = {name: letter for letter, name in SAFETY_LETTERS.items()}[mode.name]
    after = matrix(SAFETY)[event.name, letter]
    expected = mode if after == "." else SafetyMode[SAFETY_LETTERS[after]]
    assert SAFETY_TABLE.get((mode, event), mode) is expected
    safety = Safety(mode)
    assert safety.handle(event) is (after != ".")
    assert safety.mode is expected


def test_only_playing_states_count_as_running():
    running = {state for state in RuntimeState if is_running(state)}
    assert running == {RuntimeState.PLAYING, RuntimeState.PAUSING, RuntimeState.RESUMING}


# Power, with time


TIMINGS = PowerTimings(joint_boot_s=0.4, power_on_s=0.2, brake_release_s=0.3)
PERIOD_S = 0.1


def modes_seen(power, periods):
    seen = [power.robot_mode]
    for _ in range(periods):
        power.advance(PERIOD_S)
        seen.append(power.robot_mode)
    return seen


def test_power_on_takes_time_and_ends_in_idle():
    power = Power(TIMINGS)
    power.handle(PowerEvent.POWER_ON)
    assert modes_seen(power, 9) == [RobotMode.BOOTING] * 4 + [RobotMode.POWER_ON] * 2 + [RobotMode.IDLE] * 4


def test_brake_release_from_off_ends_in_running():
    power = Power(TIMINGS)
    power.handle(PowerEvent.BRAKE_RELEASE)
    seen = modes_seen(power, 10)
    assert seen[-1] is RobotMode.RUNNING
    assert seen.index(RobotMode.RUNNING) == 9  # 0.4 + 0.2 + 0.3 s


@each_row("after_periods", range(7))
def test_brake_release_during_power_on_is_remembered(after_periods):
    power = Power(TIMINGS)
    power.handle(PowerEvent.POWER_ON)
    modes_seen(power, after_periods)
    power.handle(PowerEvent.BRAKE_RELEASE)
    assert modes_seen(power, 10)[-1] is RobotMode.RUNNING


def test_power_off_cancels_a_pending_brake_release():
    power = Power(TIMINGS)
    power.handle(PowerEvent.BRAKE_RELEASE)
    power.handle(PowerEvent.POWER_OFF)
    power.handle(PowerEvent.POWER_ON)
    assert modes_seen(power, 20)[-1] is RobotMode.IDLE


def test_start_states():
    assert Power(TIMINGS).state is PowerState.OFF
    assert Power(TIMINGS, running=True).state is PowerState.RUNNING
    booting = Power(PowerTimings(controller_boot_s=0.2))
    assert modes_seen(booting, 2) == [RobotMode.BOOTING, RobotMode.BOOTING, RobotMode.POWER_OFF]


def test_every_power_state_has_a_report():
    assert set(REPORTS) == set(PowerState)


# Safety, with time and conditions


def test_only_a_protective_stop_is_locked_for_five_seconds():
    safety = Safety()
    assert safety.may_unlock_remotely
    safety.handle(SafetyEvent.PROTECTIVE_STOP)
    safety.advance(4.999)
    assert not safety.may_unlock_remotely
    safety.advance(0.001)
    assert safety.may_unlock_remotely


def test_a_second_protective_stop_does_not_restart_the_lock():
    safety = Safety()
    safety.handle(SafetyEvent.PROTECTIVE_STOP)
    safety.advance(5.0)
    assert not safety.handle(SafetyEvent.PROTECTIVE_STOP)
    assert safety.may_unlock_remotely


@each_row(
    ("opened", "closed", "status"),
    [
        ("SAFEGUARD_OPEN", "SAFEGUARD_CLOSED", SafetyStatus.SAFEGUARD_STOP),
        ("AUTOMATIC_SAFEGUARD_OPEN", "AUTOMATIC_SAFEGUARD_CLOSED", SafetyStatus.AUTOMATIC_MODE_SAFEGUARD_STOP),
        ("ENABLING_RELEASED", "ENABLING_HELD", SafetyStatus.SYSTEM_THREE_POSITION_ENABLING_STOP),
    ],
)
def test_the_status_shows_which_safeguard_is_open(opened, closed, status):
    safety = Safety()
    safety.handle(SafetyEvent[opened])
    assert (safety.mode, safety.status) == (SafetyMode.SAFEGUARD_STOP, status)
    safety.handle(SafetyEvent[closed])
    assert (safety.mode, safety.status) == (SafetyMode.NORMAL, SafetyStatus.NORMAL)


def test_closing_one_safeguard_leaves_the_other_open():
    safety = Safety()
    safety.handle(SafetyEvent.SAFEGUARD_OPEN)
    safety.handle(SafetyEvent.ENABLING_RELEASED)
    assert not safety.handle(SafetyEvent.SAFEGUARD_CLOSED)
    assert safety.status is SafetyStatus.SYSTEM_THREE_POSITION_ENABLING_STOP
    assert safety.handle(SafetyEvent.ENABLING_HELD)


def test_recovery_mode_overrides_reduced_and_yields_to_every_stop():
    safety = Safety()
    safety.handle(SafetyEvent.REDUCED)
    safety.handle(SafetyEvent.OUTSIDE_LIMITS)
    assert safety.mode is SafetyMode.RECOVERY
    assert not safety.programs_allowed
    safety.handle(SafetyEvent.ROBOT_EMERGENCY_STOP)
    safety.handle(SafetyEvent.EMERGENCY_STOP_RELEASED)
    assert safety.mode is SafetyMode.RECOVERY
    safety.handle(SafetyEvent.INSIDE_LIMITS)
    assert safety.mode is SafetyMode.REDUCED


@each_row(
    ("mode", "bits"),
    [
        (SafetyMode.NORMAL, 1),
        (SafetyMode.REDUCED, 2),
        (SafetyMode.PROTECTIVE_STOP, 4 | 1024),
        (SafetyMode.RECOVERY, 8),
        (SafetyMode.SAFEGUARD_STOP, 16 | 1024),
        (SafetyMode.SYSTEM_EMERGENCY_STOP, 32 | 128 | 1024),
        (SafetyMode.ROBOT_EMERGENCY_STOP, 64 | 128 | 1024),
        (SafetyMode.VIOLATION, 256 | 1024),
        (SafetyMode.FAULT, 512 | 1024),
    ],
)
def test_status_bits(mode, bits):
    safety = Safety(mode)
    assert safety.status_bits == bits
    assert safety.stopped is bool(bits & SafetyStatusBits.STOPPED_DUE_TO_SAFETY)
