"""A Robotiq 2-finger gripper: activation, motion, object detection, faults.

    gripper = Gripper(MODELS["robotiq-2f-85"])
    gripper.set("ACT", 1)
    while gripper.status is not Status.ACTIVE:
        gripper.advance(0.002, powered=True)

Positions are the gripper's own counts: 0 open, 255 closed; the fingers stop before either.
Facts: the maker's instruction manual, and the programs and clients of the ASCII interface.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Final

from urproto.robotiq import FULL, Fault, GripperModel, ObjectStatus, Status

SLAVE_ID: Final = 9  # of a gripper as delivered
_ACTIVATION_SPEED: Final = 255  # as SPE (guess)
_RELEASE_SPEED: Final = 0  # as SPE: automatic release is slow
# as `GET DST` reports them; the names are from the maker's programs
_DRIVER_LISTENS: Final = 1
_DRIVER_RUNS: Final = 4
_WRITABLE: Final[Mapping[str, int]] = {  # name: greatest value
    "ACT": 1, "GTO": 1, "ATR": 1, "ARD": 1, "POS": FULL, "SPE": FULL, "FOR": FULL,
    # of the maker's other grippers; stored without effect, because the maker's programs read them all
    "MOD": FULL, "LBP": FULL, "LRD": FULL, "LBL": FULL, "LGN": FULL, "MSC": FULL,
}  # fmt: skip
_ALIASES: Final = {"ADR": "ARD"}  # as a widespread client spells it
_TEXTS: Final = {"VER": "EMULATED", "FWV": "EMULATED", "SNU": "EMULATED"}


class Phase(Enum):
    """Phase of the gripper's state machine."""

    RESET = auto()
    CLOSING = auto()  # activation, first half
    OPENING = auto()  # activation, second half
    ACTIVE = auto()
    RELEASING = auto()
    RELEASED = auto()
    FAILED = auto()


class Event(Enum):
    """Events that change the phase."""

    ACTIVATE = auto()
    RESET = auto()
    RELEASE = auto()
    ARRIVED = auto()
    FAIL = auto()


TRANSITIONS: Final[Mapping[tuple[Phase, Event], Phase]] = {
    (Phase.RESET, Event.ACTIVATE): Phase.CLOSING,
    (Phase.CLOSING, Event.ARRIVED): Phase.OPENING,
    (Phase.OPENING, Event.ARRIVED): Phase.ACTIVE,
    (Phase.RELEASING, Event.ARRIVED): Phase.RELEASED,
    **{(phase, Event.RESET): Phase.RESET for phase in Phase},
    **{(phase, Event.FAIL): Phase.FAILED for phase in Phase},
    **{(phase, Event.RELEASE): Phase.RELEASING for phase in (Phase.RESET, Phase.CLOSING, Phase.OPENING, Phase.ACTIVE)},
}
_STATUS: Final = {Phase.CLOSING: Status.ACTIVATING, Phase.OPENING: Status.ACTIVATING, Phase.ACTIVE: Status.ACTIVE}
_PHASE_FAULT: Final = {Phase.RELEASING: Fault.RELEASING, Phase.RELEASED: Fault.RELEASED}
_MOTION_FAULT: Final = {
    Phase.RESET: Fault.NOT_ACTIVATED,
    Phase.CLOSING: Fault.ACTION_DELAYED,
    Phase.OPENING: Fault.ACTION_DELAYED,
}


@dataclass(frozen=True, slots=True)
class Drive:
    """Command to a gripper's motor: opening, speed, and the fraction of the maximum force (``FOR``)."""

    width_mm: float
    mm_per_s: float
    force_share: float


class Gripper:
    """One gripper on the arm.

    object_mm: width of an object between the fingers, None without one. The fingers hold it from
    outside when they close on it and from inside when they open against it. In a world with
    physics, the scene determines where the fingers are (``drive``, ``set_fingers``). ``position``:
    count, a float. ``powered`` follows the arm: a gripper without power does not answer and
    loses its activation.
    """

    def __init__(self, model: GripperModel, object_mm: float | None = None) -> None:
        self.model = model
        self.object_mm = object_mm
        self.position = float(model.open_stop)
        self.powered = False
        self.phase = Phase.RESET
        self.cycles = 0
        self._failure = Fault.NONE
        self._stopped: bool | None = None  # by an object in a scene; None without a scene
        self._moving = False
        self._closing = True  # the direction the fingers moved last
        self._set: dict[str, int] = dict.fromkeys(_WRITABLE, 0) | {"SPE": FULL, "FOR": FULL}  # guess: full
        self._read = {
            "POS": lambda: f"{round(self.position)}",
            "PRE": lambda: f"{self._set['POS']:03d}",  # three digits, FLT two: the maker's programs count them
            "FLT": lambda: f"{self.fault:02d}",
            "STA": lambda: f"{self.status:d}",
            "OBJ": lambda: f"{self.object_status:d}",
            "NCY": lambda: f"{self.cycles}",
        }

    # variables that clients read

    @property
    def status(self) -> Status:
        """Reset, being activated, active. Automatic release and faults count as reset (manual)."""
        return _STATUS.get(self.phase, Status.RESET)

    @property
    def object_status(self) -> ObjectStatus:
        """Moving, stopped by an object, or arrived. Without GTO: arrived (guess; the manual says to ignore it then)."""
        goal = self._goal()
        if goal is None or goal == self.position:
            return ObjectStatus.AT_REQUEST
        if not self._blocked(goal):
            return ObjectStatus.MOVING
        return ObjectStatus.HELD_CLOSING if goal > self.position else ObjectStatus.HELD_OPENING

    @property
    def fault(self) -> Fault:
        """Fault.NONE when there is none."""
        if self._failure is not Fault.NONE:
            return self._failure
        if self.phase in _PHASE_FAULT:
            return _PHASE_FAULT[self.phase]
        return _MOTION_FAULT.get(self.phase, Fault.NONE) if self._set["GTO"] else Fault.NONE

    def get(self, name: str) -> str | None:
        """A variable as text; None if it does not exist or the gripper has no power."""
        name = _ALIASES.get(name, name)
        if name == "PCO":  # problem of the connection
            return f"{int(not self.powered)}"
        if name == "DST":
            return f"{_DRIVER_RUNS if self.powered else _DRIVER_LISTENS}"
        if not self.powered:
            return None
        if name in self._read:
            return self._read[name]()
        if name in self._set:
            return f"{self._set[name]}"
        return _TEXTS.get(name)

    # commands

    def accepts(self, name: str, value: int) -> bool:
        """Whether the variable can be set, and to this value."""
        return 0 <= value <= _WRITABLE.get(_ALIASES.get(name, name), -1)

    def set(self, name: str, value: int) -> None:
        """Set a variable; without power, do nothing. Raises ValueError for an invalid name or value."""
        if not self.accepts(name, value):
            raise ValueError(f"the gripper has no writable variable {name} that can be {value}")
        if not self.powered:
            return
        name = _ALIASES.get(name, name)
        self._set[name] = value
        if name == "ACT":
            self._handle(Event.ACTIVATE if value else Event.RESET)
        elif name == "ATR" and value:
            self._handle(Event.RELEASE)

    def fail(self, fault: Fault) -> None:
        """Set a fault: a minor one stops the fingers until ``recover``, a major one lasts until a reset."""
        self._failure = fault
        if fault >= Fault.UNDER_VOLTAGE:
            self._handle(Event.FAIL)

    def recover(self) -> None:
        """Clear a minor fault; a major one stays."""
        if self.phase is not Phase.FAILED:
            self._failure = Fault.NONE

    def advance(self, period_s: float, *, powered: bool) -> None:
        if powered is not self.powered:
            self._switch(powered)
        goal = self._goal()
        if goal is not None and goal != self.position and not self._blocked(goal):
            self._turn_to(closing=goal > self.position)
            if self._stopped is None:
                self._move(goal, self.model.speed(self._spe()) * period_s)
            return
        self._moving = False
        if goal is not None:
            self._handle(Event.ARRIVED)

    @property
    def drive(self) -> Drive | None:
        """Command to the motor in a scene; None while the fingers hold their position."""
        goal = self._goal()
        if goal is None or not self.powered:
            return None
        share = self._set["FOR"] / FULL if self.phase is Phase.ACTIVE else 0.0  # activation: gently (guess)
        per_s = self.model.speed(self._spe()) / self.model.counts_per_mm
        return Drive(self.model.width_mm(goal), per_s, share)

    def set_fingers(self, width_mm: float, *, stopped: bool) -> None:
        """Take over where the fingers are in a scene, and whether an object there stops them."""
        count, goal = self.model.count(width_mm), self._goal()
        self._stopped = stopped
        self.position = goal if goal is not None and abs(count - goal) < 1.0 else count

    def _switch(self, powered: bool) -> None:
        self.powered = powered
        if not powered:
            self._set["ACT"] = self._set["ATR"] = 0
            self._handle(Event.RESET)

    def _handle(self, event: Event) -> None:
        self.phase = TRANSITIONS.get((self.phase, event), self.phase)
        if event is Event.RESET:
            self._set["GTO"] = 0  # guess: what was requested before is not carried out after the next activation
            self._failure = Fault.NONE

    def _spe(self) -> int:
        if self.phase is Phase.ACTIVE:
            return self._set["SPE"]
        return _RELEASE_SPEED if self.phase is Phase.RELEASING else _ACTIVATION_SPEED

    def _goal(self) -> float | None:
        """Target of the fingers; None while they hold their position."""
        model = self.model
        if self.phase is Phase.ACTIVE and self._set["GTO"] and not self._failure:
            return float(min(max(self._set["POS"], model.open_stop), model.closed_stop))
        if self.phase is Phase.CLOSING:
            return float(model.closed_stop)
        if self.phase is Phase.OPENING:
            return float(model.open_stop)
        if self.phase is Phase.RELEASING:  # ARD 0 opens for the maker's programs and ur_rtde; by the manual it closes
            return float(model.closed_stop if self._set["ARD"] else model.open_stop)
        return None

    def _stop(self) -> float | None:
        return None if self.object_mm is None else self.model.count(self.object_mm)

    def _blocked(self, goal: float) -> bool:
        """Whether an object between the fingers blocks their path to the goal."""
        if self._stopped is not None:
            return self._stopped
        return self._stop() == self.position and (goal > self.position) is self._closing

    def _turn_to(self, *, closing: bool) -> None:
        if closing and not (self._moving and self._closing):
            self.cycles += 1
        self._moving, self._closing = True, closing

    def _move(self, goal: float, way: float) -> None:
        here = self.position
        closing = goal > here
        there = min(here + way, goal) if closing else max(here - way, goal)
        stop = self._stop()
        if stop is not None and (here < stop < there or there < stop < here):
            there = stop
        self.position = there
