"""The settings of a Move for the nodes inside it, and the speed fields that several nodes share."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from urproto.vectors import ZERO6
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.forms import DEGREES, MILLI, Field, attribute_number

DIRECTION: Final = "gui.program.direction.MoveDirectionNode"

JOINTS: Final = "JointAngles"
_NO_TCP: Final = ZERO6
# defaults of a new Move, as in PolyScope: 60 degrees/s and 80 degrees/s2, or 250 mm/s and 1200 mm/s2
JOINT_DEFAULTS: Final = {"speed": "1.0471975511965976", "acceleration": "1.3962634015954636"}
TOOL_DEFAULTS: Final = {"speed": "0.25", "acceleration": "1.2"}


@dataclass(frozen=True, slots=True)
class Move:
    """The settings of a Move node for the waypoints inside it. kind: MoveJ, MoveL or MoveP."""

    element: Element
    kind: str
    optimove: bool

    @property
    def of_flange(self) -> bool:
        """Whether poses are for the flange instead of the TCP."""
        return self.element.get("useActiveTCP") == "false" and self.element.child("tcp") is None

    @property
    def call(self) -> str:
        """The built-in for the motion."""
        return ("opti" if self.optimove else "") + self.kind.lower()

    def speeds(self, waypoint: Element | None) -> tuple[str, str]:
        """Acceleration and speed: those of the waypoint if it has its own, else those of the Move."""
        space = "joint" if self.kind == "MoveJ" else "cartesian"
        own = waypoint.child("motionParameters") if waypoint is not None else None
        if own is not None and own.get(f"{space}Speed"):
            return own.get(f"{space}Acceleration"), own.get(f"{space}Speed")
        if self.optimove:
            return self.element.get("optiMoveAcceleration"), self.element.get("optiMoveSpeed")
        return self.element.get("acceleration", "1.2"), self.element.get("speed", "0.25")


def move_of(element: Element) -> Move:
    """The Move node that contains a node. Raises DocumentError without one."""
    around: Element | None = element
    while around is not None and not around.attributes.get("motionType"):
        around = around.parent
    if around is None:
        raise DocumentError(f"<{element.tag}> {element.get('name')} is not inside a Move node")
    return Move(around, around.get("motionType"), around.get("optimoveEnabled") == "true")


_SPEED_LIMIT, _ACCELERATION_LIMIT = 360.0, 2292.0  # guess [degrees/s, degrees/s2]: what the largest joints can do
_TOOL_SPEED_LIMIT, _TOOL_ACCELERATION_LIMIT = 5000.0, 150000.0  # guess [mm/s, mm/s2]


def speed_fields(
    prefix: str, title: str, names: tuple[str, str], shown: Callable[[Element], bool]
) -> tuple[Field, ...]:
    """Fields for speed and acceleration of the joints or of the tool. names: the attributes."""
    joint = prefix == "joint"
    factor, unit = (DEGREES, "°/s") if joint else (MILLI, "mm/s")
    speed, acceleration = (
        (_SPEED_LIMIT, _ACCELERATION_LIMIT) if joint else (_TOOL_SPEED_LIMIT, _TOOL_ACCELERATION_LIMIT)
    )
    return (
        attribute_number(
            f"{prefix}_speed", f"{title} speed", names[0], unit=unit, factor=factor, low=0.0, high=speed, shown=shown
        ),
        attribute_number(
            f"{prefix}_acceleration",
            f"{title} acceleration",
            names[1],
            unit=f"{unit}²",
            factor=factor,
            low=0.0,
            high=acceleration,
            shown=shown,
        ),
    )
