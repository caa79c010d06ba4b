"""Voltages, currents, energy and temperatures.

The supply current covers standby, ohmic losses and mechanical power. Energy fed back by the joints is dissipated in a
resistor, not stored. The parameters fit three recordings of real arms at rest: a UR10
(porrasp8/RTDE_PYTHON_CLIENT_LIB_EXPANDED) and two e-Series arms (nour427/TSSP-2024,
ZhizhuoUp/RTDE_Python_Client_Library_Zhizhuo). An ideal arm has constant voltages, a dynamic arm those of its series,
with their noise (``urproto.robots.measured``).

A simulator measures nothing: its constant temperatures and what it reports as voltages and current are in the ledger of
facts.
"""

from math import exp
from operator import add, mul
from typing import Final

from emulator.robot.arm import Arm
from emulator.robot.chance import Chances
from emulator.robot.efforts import Efforts, IdealEfforts
from emulator.snapshot import Snapshot
from urproto.facts import Personality, Situation, find
from urproto.robots.measured import Supply
from urproto.rtde.fields import OUTPUT_FIELDS
from urproto.vectors import ZERO6, Vector6, as_six

ROOM_C: Final = 24.0
_PERIOD_S: Final = 1.0
_METER_S: Final = 0.008  # between readings of the energy meter, the period of the slower series (guess)
# Measured: 1650 to 2300 s (mean 2020) for the joints of a real UR3 over 49 minutes ("UR3 CobotOps", UCI, in
# SparkyWolf1/python_industrial_automation_homeworks), which an exponential fits within 0.05 K. Rises: those of a warm
# CB3 arm (tests/controller/test_field_truth.py); in a hall at 29 degrees, the UR3's final values are within 1 K of
# them, its shoulder 3 K higher.
_TIME_CONSTANT_S: Final = 2000.0
_SHARE: Final = 1.0 - exp(-_PERIOD_S / _TIME_CONSTANT_S)  # fraction of the remaining difference covered in one period
_DRIVE_RISE_K: Final[Vector6] = (8.0, 8.0, 10.0, 13.0, 15.0, 16.0)  # powered, without load
_MOTOR_RISE_K_A2: Final[Vector6] = (0.04, 0.04, 0.04, 0.5, 0.5, 0.5)
_FRICTION_RISE_K_W: Final = 0.2
_TOOL_RISE_K: Final = 6.0
_BOX_RISE_K: Final = 13.0  # always on
# Measured at rest (see above): 0.681, 0.751 and 0.549 A with joint currents of 14.8, 31.3 and 0.1 A2 in all; joints
# 0.14, 0.16 and 0.23 V below the supply
_STANDBY_A: Final = 0.56  # control electronics of a powered arm
_LOSS_OHM: Final = 0.31  # per joint, motor and drive
_CABLE_OHM: Final = 0.25  # from the supply to the joints
_RULES: Final = ("measured", "zero", "twice")  # how values are reported, in the ledger


class Thermals:
    """Temperatures [degC]. A controller starts cold; the temperatures of a simulator are constant."""

    def __init__(self, situation: Situation) -> None:
        self.joints: Vector6 = (ROOM_C,) * 6
        self.tool = ROOM_C
        self.box = ROOM_C
        self.elapsed_s = 0.0
        self._constant = situation.personality is Personality.URSIM
        if self._constant:
            self.joints = find("joint_temperatures", situation).six
            self.tool, self.box = (find(name, situation).number for name in ("tool_temperature", "board_temperature"))

    def advance(
        self, efforts: IdealEfforts | Efforts, period_s: float, *, powered: bool, friction_W: Vector6 = ZERO6
    ) -> bool:
        """Advance one control period with the currents of these efforts and this heat of friction [W].

        Returns True if the temperatures were updated.
        """
        if self._constant:
            return False
        self.elapsed_s += period_s
        if self.elapsed_s < _PERIOD_S:
            return False
        self.elapsed_s -= _PERIOD_S
        self.joints = _approach6(self.joints, _joint_rises(efforts.actual_current, friction_W) if powered else ZERO6)
        self.tool = _approach(self.tool, _TOOL_RISE_K if powered else 0.0)
        self.box = _approach(self.box, _BOX_RISE_K)
        return True


def _joint_rises(current: Vector6, friction_W: Vector6) -> Vector6:
    motors = map(add, _DRIVE_RISE_K, map(mul, _MOTOR_RISE_K_A2, map(mul, current, current)))
    a, b, c, d, e, f = map(add, motors, [_FRICTION_RISE_K_W * heat for heat in friction_W])
    return (a, b, c, d, e, f)


def _approach(temperature: float, rise: float) -> float:
    return temperature + _SHARE * (ROOM_C + rise - temperature)


def _approach6(temperatures: Vector6, rises: Vector6) -> Vector6:
    a, b, c, d, e, f = map(_approach, temperatures, rises)
    return (a, b, c, d, e, f)


class Electrics:
    """Supply current, energy and temperatures, derived from the joint currents.

    situation: whose values are reported. supply: a real arm's, with noise. The energy meter, of the versions that have
    one, adds what is drawn every 8 ms.
    """

    def __init__(self, situation: Situation, chances: Chances, supply: Supply | None = None) -> None:
        self._main_V, self._robot_V = (find(name, situation).number for name in ("main_voltage", "robot_voltage"))
        self._current, self._joint_voltages, self._tool_voltage = (
            _rule(name, situation) for name in ("robot_current", "joint_voltages", "tool_voltage")
        )
        self._supply = supply
        # whether a period shows what is drawn
        self._shown = self._current != "zero" or self._joint_voltages != "zero"
        period_s = situation.version.series.period_s
        metered = OUTPUT_FIELDS["actual_robot_energy_consumed"].available.covers(situation.version)
        self._reading_after = round(_METER_S / period_s) if metered else 0
        self.periods = 0  # since the last reading of the energy meter
        self._chance = chances.stream("supply")  # separate from the noise of currents
        self.robot_current_A = 0.0
        self.energy_J = 0.0
        self.braking_energy_J = 0.0
        self.thermals = Thermals(situation)
        self._braking_W = 0.0
        self._stale = True  # the arm's efforts have changed since the last draw was calculated
        self._measured: tuple[float, ...] | None = None
        self._news = True  # a value that is published only when it changes has changed

    def advance(self, arm: Arm, period_s: float, *, powered: bool, changed: bool) -> None:
        """Advance one control period. ``changed``: the arm's torques or its power differ from the last one's."""
        if changed:
            self._news = self._stale = True
            if self._shown:
                self._draw(arm, powered)
        if self._reading_after:
            self.periods += 1
            if self.periods >= self._reading_after:
                self._read_meter(arm, period_s, powered)
        if self._supply is not None:
            self._measured = self._measure(self._supply, powered)
        if self.thermals.advance(arm.efforts, period_s, powered=powered, friction_W=arm.friction_W):
            self._news = True

    def _read_meter(self, arm: Arm, period_s: float, powered: bool) -> None:
        if self._stale:
            self._draw(arm, powered)
        time_s, self.periods = self.periods * period_s, 0
        self.energy_J += self._robot_V * self.robot_current_A * time_s
        self.braking_energy_J += self._braking_W * time_s

    def mark(self) -> None:
        """Let the next ``publish`` write everything."""
        self._news = True

    def publish(self, snapshot: Snapshot, *, powered: bool) -> None:
        """Write everything that has changed since the last snapshot."""
        snapshot.actual_robot_energy_consumed = self.energy_J
        snapshot.actual_robot_braking_energy_dissipated = self.braking_energy_J
        if self._measured is not None:
            snapshot.actual_main_voltage, snapshot.actual_robot_voltage, snapshot.actual_robot_current, *rest = (
                self._measured
            )
            snapshot.actual_joint_voltage, snapshot.tool_board_voltage = as_six(rest), snapshot.actual_robot_voltage
        if not self._news:
            return
        self._news = False
        if self._supply is None:
            robot_V = self._robot_V if powered else 0.0
            snapshot.actual_main_voltage, snapshot.actual_robot_voltage = self._main_V, robot_V
            snapshot.actual_robot_current = 0.0 if self._current == "zero" else self.robot_current_A
            joints_V = self._joint_voltage(robot_V) if powered and self._joint_voltages == "measured" else 0.0
            snapshot.actual_joint_voltage = (joints_V,) * 6
            snapshot.tool_board_voltage = robot_V if self._tool_voltage == "measured" else 0.0
        snapshot.joint_temperatures = self.thermals.joints
        snapshot.tool_temperature = self.thermals.tool
        snapshot.board_temperature = self.thermals.box

    def _measure(self, supply: Supply, powered: bool) -> tuple[float, ...]:
        """Main and robot voltage, robot current, and six joint voltages, as measured by a real arm."""
        gauss = self._chance.gauss
        main_V = gauss(supply.main_V, supply.main_noise_V)
        if not powered:
            return (main_V, *(0.0,) * 8)
        joints_V = self._joint_voltage(supply.robot_V)
        return (
            main_V,
            gauss(supply.robot_V, supply.robot_noise_V),
            gauss(self.robot_current_A, supply.current_noise_A),
            *(gauss(joints_V, supply.joint_noise_V) for _ in range(6)),
        )

    def _joint_voltage(self, supply_V: float) -> float:
        return supply_V - _CABLE_OHM * self.robot_current_A

    def _draw(self, arm: Arm, powered: bool) -> None:
        self._stale = False
        power_W = _joint_power(arm) if powered else 0.0
        self._braking_W = max(0.0, -power_W)
        if not powered:
            self.robot_current_A = 0.0
        elif self._current == "twice":
            self.robot_current_A = 2.0 * sum(map(abs, arm.efforts.actual_current))
        else:
            self.robot_current_A = _STANDBY_A + max(0.0, power_W) / self._robot_V


def _rule(name: str, situation: Situation) -> str:
    """How a value is reported. Raises ValueError for a rule that is not known here."""
    fact = find(name, situation)
    if fact.value not in _RULES:
        raise ValueError(f"{fact.table}.csv: {name} is {fact.value!r}, which is none of {', '.join(_RULES)}")
    return fact.value


def _joint_power(arm: Arm) -> float:
    """Power taken by all joints: losses and mechanical power; negative while they brake."""
    current = arm.efforts.actual_current
    losses: float = _LOSS_OHM * sum(map(mul, current, current))
    mechanical: float = sum(map(mul, arm.efforts.actual_torque, arm.qd))
    return losses + mechanical
