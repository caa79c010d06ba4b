"""Fixed, relative and variable waypoints: teaching, moving to them, and circle moves through two of them."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

from urproto.robots import RobotModel
from urproto.robots.pose import pose_inv, pose_trans
from urproto.vectors import ZERO6
from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.forms import (
    MILLI,
    Field,
    attribute_choice,
    attribute_number,
    in_child,
    node_name,
    of_type,
    own_child,
    variable_field,
)
from urscript.polyscope.nodes.motion import (
    DIRECTION,
    JOINT_DEFAULTS,
    JOINTS,
    TOOL_DEFAULTS,
    Move,
    move_of,
    speed_fields,
)
from urscript.polyscope.nodes.operator import variable_shown
from urscript.polyscope.numbers import doubles_text, identifier, inverse_text, list_text, pose_text, six, taught_pose
from urscript.polyscope.registry import Kind, node
from urscript.polyscope.surroundings import FieldError, Surroundings
from urscript.polyscope.writer import BASE, NO_POSE, TOOL, Writer, variable_name

TAUGHT: Final = ("relativeFromPosition", "position", "poseInFeatureCoordinates", "outputFlangePose", "BaseToFeature")
_TYPES: Final = {"Fixed": "Fixed position", "Relative": "Relative position", "Variable": "Variable position"}
_MOTION: Final = "motionParameters"  # the waypoint's own speed, time or blend
_UNKNOWN_FLAGS: Final = "-1"  # configuration of the arm at a waypoint that is not fixed
_OWN_SPEEDS: Final = ("jointSpeed", "jointAcceleration", "cartesianSpeed", "cartesianAcceleration")


def new_waypoint(program: Surroundings) -> Element:
    name = program.unused("Waypoint", program.names("Waypoint"))
    return make("Waypoint", make(_MOTION), type="Fixed", name=name, kinematicsFlags="1")


def _choose_type(element: Element, value: str, program: Surroundings) -> None:
    """Choose the type of waypoint; removes taught positions or the variable that do not belong to it."""
    for tag in (*TAUGHT, "variable"):
        if value != "Relative" or tag not in ("position", "BaseToFeature"):
            program.set_child(element, tag, None)
    program.set_attribute(element, "type", value)
    program.set_attribute(element, "kinematicsFlags", _UNKNOWN_FLAGS if value == "Variable" else "1")


def _motion_read(element: Element, _: Surroundings) -> str:
    own = element.child(_MOTION)
    if own is None:
        return "shared"
    return "time" if own.get("nextMotionTime") else "speed" if own.get("jointSpeed") else "shared"


def _motion_write(element: Element, value: str, program: Surroundings) -> None:
    own = own_child(element, _MOTION, program)
    for name in (*_OWN_SPEEDS, "nextMotionTime"):
        program.set_attribute(own, name, None)
    if value == "speed":
        defaults = (*JOINT_DEFAULTS.values(), *TOOL_DEFAULTS.values())
        for name, default in zip(_OWN_SPEEDS, defaults, strict=True):
            program.set_attribute(own, name, default)
    elif value == "time":
        program.set_attribute(own, "nextMotionTime", "2.0")


def _has_motion(value: str) -> Callable[[Element], bool]:
    def shown(element: Element) -> bool:
        own = element.child(_MOTION)
        return own is not None and bool(own.get("nextMotionTime" if value == "time" else "jointSpeed"))

    return shown


def _position_read(tag: str) -> Callable[[Element, Surroundings], Any]:
    def read(element: Element, _: Surroundings) -> Any:
        """Joint angles [rad] and TCP pose in the base frame; None before it is taught."""
        position = element.child(tag)
        if position is None:
            return None
        joints, pose = taught_pose(position)
        return {"joints": list(joints), "pose": list(pose)}

    return read


def _position_write(element: Element, value: Any, _: Surroundings) -> None:
    raise FieldError("a position cannot be typed in: teach it with joints, pose and TCP")


def _position_field(key: str, title: str, tag: str, *types: str) -> Field:
    return Field(key, title, "position", _position_read(tag), _position_write, shown=of_type(*types), optional=True)


def _waypoint_lacks(element: Element) -> str:
    kind = element.get("type")
    if kind == "Variable":
        return "" if element.child("variable") else "the variable with its pose"
    if kind == "Relative" and element.child("relativeFromPosition") is None:
        return "the position it is relative to"
    return "" if element.child("position") else "its position: teach it"


WAYPOINT: Final = Kind(
    "waypoint",
    "Waypoint",
    "Basic",
    lambda element: (
        variable_shown(element.child("variable"))
        if element.get("type") == "Variable"
        else element.get("name") or "Waypoint"
    ),
    new=new_waypoint,
    stands="move",
    undefined=_waypoint_lacks,
    fields=(
        node_name(what="waypoint"),
        attribute_choice("type", "Type", "type", _TYPES, _choose_type),
        _position_field("position", "Position", "position", "Fixed"),
        _position_field("from", "From", "relativeFromPosition", "Relative"),
        _position_field("to", "To", "position", "Relative"),
        variable_field("variable", "Variable", shown=of_type("Variable")),
        Field(
            "own_motion",
            "Speed",
            "choice",
            _motion_read,
            _motion_write,
            choices=(("shared", "Shared parameters"), ("speed", "Own speed"), ("time", "Time")),
        ),
        *(
            in_child(_MOTION, field)
            for field in (
                *speed_fields("joint", "Joint", _OWN_SPEEDS[:2], _has_motion("speed")),
                *speed_fields("tool", "Tool", _OWN_SPEEDS[2:], _has_motion("speed")),
                attribute_number("time", "Time", "nextMotionTime", unit="s", low=0.0, shown=_has_motion("time")),
                attribute_number(
                    "blend", "Blend radius", "blendRadius", unit="mm", factor=MILLI, low=0.0, optional=True
                ),
            )
        ),
    ),
)


def teach(
    element: Element,
    program: Surroundings,
    joints: Sequence[float],
    pose: Sequence[float],
    tcp: Sequence[float],
    *,
    start: bool = False,
) -> None:
    """Set a waypoint to the current position of the arm.

    joints [rad]; pose: TCP in the base frame; tcp: TCP in the flange frame [m, rad]. start: set the first of the two
    positions of a relative waypoint. Raises FieldError if the pose is in a variable, or if the arm is not known.
    """
    kind = element.get("type")
    if kind == "Variable":
        raise FieldError("its pose is in a variable and cannot be taught")
    if start and kind != "Relative":
        raise FieldError("only a relative waypoint has a starting position")
    tag = "relativeFromPosition" if start else "position"
    feature = _taught_feature(element, program)
    if program.cb3:
        flange = pose_trans(pose, pose_inv(tcp))
        program.set_child(element, tag, make(tag, joints=_six_text(joints), pose=_six_text(pose)))
        if not start:
            in_feature = pose_trans(pose_inv(feature), pose)
            program.set_child(
                element, "poseInFeatureCoordinates", make("poseInFeatureCoordinates", pose=_six_text(in_feature))
            )
            program.set_child(element, "outputFlangePose", make("outputFlangePose", pose=_six_text(flange)))
    else:
        position = make(
            tag, make("JointAngles", angles=_six_text(joints)), make("TCPOffset", pose=_six_text(tcp)), _arm(program)
        )
        program.set_child(element, tag, position)
        if not start:
            program.set_child(element, "BaseToFeature", make("BaseToFeature", pose=_six_text(feature)))
    if not start:
        program.set_attribute(element, "kinematicsFlags", str(configuration(joints, program)))


def _six_text(values: Sequence[float]) -> str:
    if len(values) != 6 or not all(math.isfinite(value) for value in values):
        raise FieldError(f"expected six numbers, not {list(values)}")
    return doubles_text(values)


def _taught_feature(element: Element, program: Surroundings) -> Sequence[float]:
    """Pose of the feature of the Move that contains a waypoint, in the base frame."""
    try:
        name = move_of(element).element.named("feature")
    except DocumentError:
        return ZERO6
    return program.installation.features.get(name, ZERO6)


def _arm(program: Surroundings) -> Element:
    """The dimensions of the arm used for teaching: those saved with the program, or those of the model."""
    saved = program.root.child("kinematics")
    if saved is not None:
        arm = make("Kinematics", *(make(child.tag, **child.attributes) for child in saved.children))
        arm.attributes = dict(saved.attributes)
        return arm
    if program.model is None:
        raise FieldError("the program does not say which arm it is for, so positions cannot be taught")
    return kinematics_element("Kinematics", program.model)


def kinematics_element(tag: str, model: RobotModel) -> Element:
    """The dimensions of an arm as PolyScope saves them for an arm without calibration."""
    rows = {"deltaTheta": model.dh.theta, "a": model.dh.a, "d": model.dh.d, "alpha": model.dh.alpha}
    return make(
        tag,
        *(make(name, value=_six_text(row)) for name, row in rows.items()),
        make("jointChecksum", value=", ".join(["-1"] * 6)),
        status="NOT_INITIALIZED",
        validChecksum="false",
    )


def configuration(joints: Sequence[float], program: Surroundings) -> int:
    """``kinematicsFlags``: which of the eight inverse kinematics solutions the arm is in.

    Bit 1: wrist 2 is negative; bit 2: the elbow is negative; bit 0: the elbow is not negative. This matches 97 % of
    6600 taught waypoints; the rule for bits 0 and 2 in the others is not known.
    """
    elbow, wrist = (math.remainder(joints[index], 2 * math.pi) for index in (2, 4))
    return (1 if elbow >= 0 else 0) | (2 if wrist < 0 else 0) | (4 if elbow < 0 else 0)


@node(
    "Waypoint",
    WAYPOINT,
    attributes="type name kinematicsFlags",
    children="motionParameters variable relativeFromPosition position poseInFeatureCoordinates outputFlangePose "
    "BaseToFeature",
)
def waypoint(writer: Writer, element: Element) -> None:
    """Move to a fixed, relative or variable position; it may have its own speed, time or blend."""
    way = move_of(element)
    writer.label(element, _shown_name(element), "breakAfter")
    if not (way.kind == "MoveJ" and way.element.get("positionType") == JOINTS):  # joints need no TCP
        _set_tcp(writer, way)
    target = _target(writer, element, way)
    own = element.child(_MOTION)
    time = own.get("nextMotionTime") if own else ""
    if time and way.kind != "MoveP" and not way.optimove:
        writer.line(f"{way.call}({target}, t={time}{_blend(writer, element, way)})")
        return
    acceleration, speed = way.speeds(element)
    writer.line(f"{way.call}({target}, a={acceleration}, v={speed}{_blend(writer, element, way)})")


def _set_tcp(writer: Writer, way: Move) -> None:
    """Set the TCP of the Move, as PolyScope does before each of its waypoints."""
    tcp = way.element.child("tcp")
    if way.element.get("useActiveTCP") == "false" and tcp:
        writer.line(f"set_tcp({writer.tcp(tcp)})")


def _shown_name(element: Element) -> str:
    if element.get("type") == "Variable" and element.child("variable"):
        return variable_name(element.child("variable"))
    return element.get("name") or "Waypoint"


def _blend(writer: Writer, element: Element, way: Move) -> str:
    own = element.child(_MOTION)
    radius = own.get("blendRadius") if own else ""
    if way.kind == "MoveP":
        return f", r={_path_blend(writer, element, way, radius)}"
    return f", r={radius}" if radius and float(radius) > 0.0 else ""


def _path_blend(writer: Writer, point: Element, way: Move, own: str) -> str:
    """The blend radius of a MoveP waypoint.

    It is 0 at the end of the path, where the next line of the tree is a Move of another kind; not if that Move begins
    with a Direction, and not if anything else is in between (seen in 700 MoveP of public pairs).
    """
    tree = writer.home(point)
    after = [line.element for line in tree.lines[writer.line_in(tree, point) :][:2]]
    moves_on = bool(after) and after[0].tag == "Move" and after[0].get("motionType") != "MoveP"
    if moves_on and not (len(after) > 1 and after[1].tag == DIRECTION):
        return "0.0"
    return own or way.element.get("blendRadius") or "0.0"


def _target(writer: Writer, element: Element, way: Move) -> str:
    """The first argument of the move."""
    kind = element.get("type")
    if kind == "Variable":
        return _in_feature(writer, way, variable_name(element.child("variable")))
    if kind == "Relative":
        return _relative(writer, element)
    if kind and kind != "Fixed":
        raise DocumentError(f"a waypoint of unknown type {kind!r}")
    pose, joints = writer.waypoint(element)
    if way.kind != "MoveJ":
        return _of_flange(way, _followed(writer, element, way, pose))
    if way.element.get("positionType") == JOINTS or way.optimove:
        return joints
    of_tcp = way.element.get("useActiveTCP") == "true"
    if not way.element.get("positionType") and not of_tcp:  # before 5.0 such a MoveJ went to the joints taught
        position = element.child("position")
        assert position is not None
        return list_text(taught_pose(position)[0])
    return f"get_inverse_kin({_of_flange(way, _followed(writer, element, way, pose))}, qnear={joints})"


def _of_flange(way: Move, pose: str) -> str:
    """The TCP pose for a pose of the flange (seen with MoveJ)."""
    return f"pose_trans({pose}, get_tcp_offset())" if way.of_flange else pose


def _in_feature(writer: Writer, way: Move, pose: str) -> str:
    """The base-frame pose of a pose relative to the Move's feature; a variable feature is read when the move starts.

    A Move that ignores the active TCP names the base as well, and leaves the pose as it is (two public pairs of .urp
    and .script, PolyScope 3.5.4 and 3.15.8).
    """
    feature = writer.feature(way.element.child("feature"), variable=True)
    return pose if feature == NO_POSE and not way.of_flange else f"pose_trans({feature}, {pose})"


def _followed(writer: Writer, element: Element, way: Move, pose: str) -> str:
    """A taught pose; it follows its feature when that is a variable and has been moved."""
    name = way.element.named("feature")
    taught = element.child("BaseToFeature")
    if name in ("", BASE, TOOL) or taught is None or name not in writer.installation.feature_variables:
        return pose
    return f"pose_trans({identifier(name)}, pose_trans({inverse_text(six(taught.get('pose')))}, {pose}))"


def _relative(writer: Writer, element: Element) -> str:
    """The target of a relative waypoint: displaced from the arm's current pose like its two taught positions."""
    start, goal = element.child("relativeFromPosition"), element.child("position")
    if start is None or goal is None:
        raise DocumentError(f"the relative waypoint {element.get('name')} was never taught")
    name = identifier(element.get("name") or "Waypoint")
    if writer.once(f"relative waypoint {name}"):
        with writer.into("waypoints"):
            writer.line(f"global {name}_from_p={pose_text(taught_pose(start)[1])}")
            writer.line(f"global {name}_to_p={pose_text(taught_pose(goal)[1])}")
    return f"pose_add(get_target_tcp_pose(), pose_sub({name}_to_p, {name}_from_p))"


def _new_circle(program: Surroundings) -> Element:
    via = new_waypoint(program)
    end = new_waypoint(program)
    end.attributes["name"] = program.unused("Waypoint", [*program.names("Waypoint"), via.attributes["name"]])
    return make("CircleMove", make("children", via, end), OrientationMode="UNCONSTRAINED")


CIRCLE: Final = Kind(
    "circle_move",
    "CircleMove",
    "Basic",
    lambda _: "CircleMove",
    new=_new_circle,
    stands="move",
    contains="circle",
    fields=(
        attribute_choice(
            "orientation", "Mode", "OrientationMode", {"UNCONSTRAINED": "Unconstrained", "FIXED": "Fixed"}
        ),
    ),
)


@node("CircleMove", CIRCLE)
def circle_move(writer: Writer, element: Element) -> None:
    """Move on an arc through one waypoint to another."""
    way = move_of(element)
    children = element.child("children")
    points = [child for child in children or () if child.tag == "Waypoint"]
    if len(points) != 2:
        raise DocumentError("a CircleMove needs a via point and an end point")
    writer.label(element, "CircleMove")
    writer.label(points[0], _shown_name(points[0]), "noBreak")
    writer.label(points[1], _shown_name(points[1]), "breakAfter")
    _set_tcp(writer, way)
    via, end = (_target(writer, point, way) for point in points)
    acceleration, speed = way.speeds(points[1])
    own = points[1].child(_MOTION)
    blend = _path_blend(writer, points[1], way, own.get("blendRadius") if own else "")
    mode = ", mode=1" if element.get("OrientationMode") == "FIXED" else ""
    writer.line(f"movec({via}, {end}, a={acceleration}, v={speed}, r={blend}{mode})")
