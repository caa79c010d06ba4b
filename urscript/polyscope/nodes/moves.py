"""Move nodes, and the move to the home position."""

from typing import Final

from urproto.versions import Availability
from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.forms import (
    MILLI,
    Field,
    attribute_boolean,
    attribute_choice,
    attribute_number,
    feature_field,
    having,
)
from urscript.polyscope.nodes.motion import JOINT_DEFAULTS, JOINTS, TOOL_DEFAULTS, speed_fields
from urscript.polyscope.nodes.outputs import tcp_names
from urscript.polyscope.nodes.waypoints import new_waypoint
from urscript.polyscope.numbers import list_text
from urscript.polyscope.registry import Kind, node, translate_children
from urscript.polyscope.surroundings import FieldError, Surroundings
from urscript.polyscope.writer import BASE, Writer
from urscript.work import Steps

_BLEND_DEFAULT: Final = "0.025"  # m, of a MoveP
_OPTIMOVES: Final = Availability.since(None, "5.21")  # seen from there on
_MOTIONS: Final = {kind: kind for kind in ("MoveJ", "MoveL", "MoveP")}
_ACTIVE, _FLANGE = "Active TCP", "Tool flange"
_BY_SPEED, _BY_TIME = "SPEED_AND_ACCELERATION", "TIME"  # the second is a guess: no public file has it
_BY: Final = "positionOptionType"

HOME: Final = Kind(
    "home",
    "Home",
    "Advanced",
    lambda _: "Home",
    new=lambda _: make("SafeHome", positionOptionType=_BY_SPEED, **JOINT_DEFAULTS, nextMotionTime="2.0"),
    available=Availability.since(None, "5.4"),  # guess: seen from 5.11 on
    fields=(
        attribute_choice("option", "Move by", _BY, {_BY_SPEED: "Speed and acceleration", _BY_TIME: "Time"}),
        *speed_fields("joint", "Joint", ("speed", "acceleration"), having(_BY, _BY_SPEED)),
        attribute_number("time", "Time", "nextMotionTime", unit="s", low=0.0, shown=having(_BY, _BY_TIME)),
    ),
)

_is_joint: Final = having("motionType", "MoveJ")


def _choose_motion(element: Element, value: str, program: Surroundings) -> None:
    """Choose another motion type. Its speeds have other units, so they are reset to the defaults."""
    if (value == "MoveJ") != _is_joint(element):
        for name, default in (JOINT_DEFAULTS if value == "MoveJ" else TOOL_DEFAULTS).items():
            program.set_attribute(element, name, default)
        if element.get("positionType") == JOINTS:
            program.set_attribute(element, "positionType", "CartesianPose")
    program.set_attribute(element, "motionType", value)
    program.set_attribute(element, "blendRadius", _BLEND_DEFAULT if value == "MoveP" else None)


def _tcp_read(element: Element, _: Surroundings) -> str:
    return element.named("tcp") or (_FLANGE if element.get("useActiveTCP") == "false" else _ACTIVE)


def _tcp_write(element: Element, value: str, program: Surroundings) -> None:
    own = value not in (_ACTIVE, _FLANGE)
    if own and value not in program.installation.tcps:
        raise FieldError(f"the installation {program.installation.name} has no TCP called {value!r}")
    program.set_attribute(element, "useActiveTCP", "true" if value == _ACTIVE else "false")
    program.set_child(element, "tcp", program.named("tcp", value) if own else None)


def _new_move(program: Surroundings) -> Element:
    element = make(
        "Move",
        program.feature(BASE),
        make("children", new_waypoint(program)),
        motionType="MoveJ",
        **JOINT_DEFAULTS,
        useActiveTCP="true",
    )
    if not program.cb3:
        element.attributes["positionType"] = "CartesianPose"
    if _OPTIMOVES.covers(program.version):
        element.attributes |= {"optimoveEnabled": "false", "optiMoveSpeed": "0.3", "optiMoveAcceleration": "0.09"}
    return element


MOVE: Final = Kind(
    "move",
    "Move",
    "Basic",
    lambda element: element.get("motionType"),
    new=_new_move,
    contains="nodes",
    fields=(
        attribute_choice("motion", "Motion", "motionType", _MOTIONS, _choose_motion),
        Field("tcp", "Set TCP", "tcp", _tcp_read, _tcp_write, options=lambda p: [_ACTIVE, _FLANGE, *tcp_names(p)]),
        feature_field("feature", "Feature"),
        *speed_fields("joint", "Joint", ("speed", "acceleration"), _is_joint),
        *speed_fields("tool", "Tool", ("speed", "acceleration"), lambda element: not _is_joint(element)),
        attribute_number(
            "blend",
            "Blend radius",
            "blendRadius",
            unit="mm",
            factor=MILLI,
            low=0.0,
            shown=having("motionType", "MoveP"),
        ),
        attribute_boolean(
            "joint_angles",
            "Use joint angles",
            "positionType",
            values=("CartesianPose", JOINTS),
            shown=lambda element: _is_joint(element) and bool(element.get("positionType")),
        ),
        attribute_boolean(
            "optimove", "OptiMove", "optimoveEnabled", shown=lambda element: bool(element.get("optimoveEnabled"))
        ),
        *(
            attribute_number(
                f"optimove_{name.lower()}",
                f"OptiMove {name.lower()}",
                f"optiMove{name}",
                unit="%",
                factor=0.01,
                low=0.0,
                high=100.0,
                shown=having("optimoveEnabled", "true"),
            )
            for name in ("Speed", "Acceleration")
        ),
    ),
)


@node(
    "Move",
    MOVE,
    attributes="motionType speed acceleration blendRadius useActiveTCP positionType optimoveEnabled optiMoveSpeed "
    "optiMoveAcceleration",
    children="tcp feature children",
)
def move(writer: Writer, element: Element) -> Steps[None]:
    """Move through waypoints with MoveJ, MoveL or MoveP; it may have its own TCP or feature."""
    writer.label(element, element.get("motionType"))
    yield from translate_children(writer, element)


@node("SafeHome", HOME)
def safe_home(writer: Writer, element: Element) -> None:
    """Move to the home position of the installation."""
    home = writer.installation.home
    if home is None:
        raise DocumentError(f"the installation {writer.installation.name} has no home position")
    writer.label(element, "Home")
    if "TIME" in element.get("positionOptionType"):
        how = f"t={element.get('nextMotionTime')}"
    else:
        how = f"a={element.get('acceleration')}, v={element.get('speed')}"
    writer.line(f"movej({list_text(home)}, {how})")
