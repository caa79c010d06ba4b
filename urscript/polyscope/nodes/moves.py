"""Moves and their waypoints."""

from dataclasses import dataclass
from typing import Final

from urproto.vectors import ZERO6
from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.naming import identifier
from urscript.polyscope.numbers import inverse_text, list_text, pose_text, six, taught_pose
from urscript.polyscope.registry import node, translate_children
from urscript.polyscope.writer import BASE, NO_POSE, TOOL, Writer, variable_name
from urscript.work import Steps

DIRECTION: Final = "gui.program.direction.MoveDirectionNode"

_JOINTS: Final = "JointAngles"
_NO_TCP: Final = ZERO6


@dataclass(frozen=True, slots=True)
class Move:
    """What a Move node says for the waypoints in it. kind: MoveJ, MoveL or MoveP."""

    element: Element
    kind: str
    optimove: bool

    @property
    def of_flange(self) -> bool:
        """Whether the flange is moved, and not the TCP."""
        return self.element.get("useActiveTCP") == "false" and self.element.child("tcp") is None

    @property
    def call(self) -> str:
        """The built-in that moves."""
        return ("opti" if self.optimove else "") + self.kind.lower()

    def speeds(self, waypoint: Element | None) -> tuple[str, str]:
        """Acceleration and speed, the waypoint's own if it has them."""
        space = "joint" if self.kind == "MoveJ" else "cartesian"
        own = waypoint.child("motionParameters") if waypoint is not None else None
        if own is not None and own.get(f"{space}Speed"):
            return own.get(f"{space}Acceleration"), own.get(f"{space}Speed")
        if self.optimove:
            return self.element.get("optiMoveAcceleration"), self.element.get("optiMoveSpeed")
        return self.element.get("acceleration", "1.2"), self.element.get("speed", "0.25")


def move_of(element: Element) -> Move:
    """The Move node around a node. Raises DocumentError without one."""
    around: Element | None = element
    while around is not None and not around.attributes.get("motionType"):
        around = around.parent
    if around is None:
        raise DocumentError(f"<{element.tag}> {element.get('name')} is in no Move node")
    return Move(around, around.get("motionType"), around.get("optimoveEnabled") == "true")


@node("Move")
def move(writer: Writer, element: Element) -> Steps[None]:
    """A way through waypoints: MoveJ, MoveL or MoveP, with an own TCP or feature."""
    writer.label(element, element.get("motionType"))
    yield from translate_children(writer, element)


@node("Waypoint")
def waypoint(writer: Writer, element: Element) -> None:
    """A place to move to: fixed, relative or in a variable, with its own speed, time or blend."""
    way = move_of(element)
    writer.label(element, _shown_name(element), "breakAfter")
    if not (way.kind == "MoveJ" and way.element.get("positionType") == _JOINTS):  # joints need no TCP
        _set_tcp(writer, way)
    target = _target(writer, element, way)
    own = element.child("motionParameters")
    time = own.get("nextMotionTime") if own else ""
    if time and way.kind != "MoveP" and not way.optimove:
        writer.line(f"{way.call}({target}, t={time}{_blend(writer, element, way)})")
        return
    acceleration, speed = way.speeds(element)
    writer.line(f"{way.call}({target}, a={acceleration}, v={speed}{_blend(writer, element, way)})")


def _set_tcp(writer: Writer, way: Move) -> None:
    """PolyScope sets the TCP of a Move before each of its waypoints."""
    tcp = way.element.child("tcp")
    if way.element.get("useActiveTCP") == "false" and tcp:
        writer.line(f"set_tcp({writer.tcp(tcp)})")


def _shown_name(element: Element) -> str:
    if element.get("type") == "Variable" and element.child("variable"):
        return variable_name(element.child("variable"))
    return element.get("name") or "Waypoint"


def _blend(writer: Writer, element: Element, way: Move) -> str:
    own = element.child("motionParameters")
    radius = own.get("blendRadius") if own else ""
    if way.kind == "MoveP":
        return f", r={_path_blend(writer, element, way, radius)}"
    return f", r={radius}" if radius and float(radius) > 0.0 else ""


def _path_blend(writer: Writer, point: Element, way: Move, own: str) -> str:
    """A path's blend. It ends, without one, where the next line of the tree is a Move of another kind; not if that
    begins with a Direction, and not if anything else is between (seen in 700 MoveP of public pairs)."""
    tree = writer.home(point)
    after = [line.element for line in tree.lines[writer.line_in(tree, point) :][:2]]
    moves_on = bool(after) and after[0].tag == "Move" and after[0].get("motionType") != "MoveP"
    if moves_on and not (len(after) > 1 and after[1].tag == DIRECTION):
        return "0.0"
    return own or way.element.get("blendRadius") or "0.0"


def _target(writer: Writer, element: Element, way: Move) -> str:
    """What the move's first argument is."""
    kind = element.get("type")
    if kind == "Variable":
        return _of_flange(way, _in_feature(writer, way, variable_name(element.child("variable"))))
    if kind == "Relative":
        return _relative(writer, element)
    if kind and kind != "Fixed":
        raise DocumentError(f"a waypoint of type {kind!r}, which is not known")
    pose, joints = writer.waypoint(element)
    if way.kind != "MoveJ":
        return _of_flange(way, _followed(writer, element, way, pose))
    if way.element.get("positionType") == _JOINTS or way.optimove:
        return joints
    of_tcp = way.element.get("useActiveTCP") == "true"
    if not way.element.get("positionType") and not of_tcp:  # before 5.0 such a MoveJ went to the joints taught
        position = element.child("position")
        assert position is not None
        return list_text(taught_pose(position)[0])
    return f"get_inverse_kin({_of_flange(way, _followed(writer, element, way, pose))}, qnear={joints})"


def _of_flange(way: Move, pose: str) -> str:
    """Where the TCP has to be when the pose is one for the flange (seen with MoveJ; with variables it is a guess)."""
    return f"pose_trans({pose}, get_tcp_offset())" if way.of_flange else pose


def _in_feature(writer: Writer, way: Move, pose: str) -> str:
    """A pose that is relative to the move's feature, as it is by then if it is a variable."""
    feature = writer.feature(way.element.child("feature"), variable=True)
    return pose if feature == NO_POSE else f"pose_trans({feature}, {pose})"


def _followed(writer: Writer, element: Element, way: Move, pose: str) -> str:
    """A taught pose, which follows its feature when that is a variable and has been moved."""
    reference = way.element.child("feature")
    name = reference.get("referencedName") or reference.get("featureName") if reference else ""
    taught = element.child("BaseToFeature")
    if name in ("", BASE, TOOL) or taught is None or name not in writer.installation.feature_variables:
        return pose
    return f"pose_trans({identifier(name)}, pose_trans({inverse_text(six(taught.get('pose')))}, {pose}))"


def _relative(writer: Writer, element: Element) -> str:
    """As far from where the arm is as the second taught position is from the first."""
    start, goal = element.child("relativeFromPosition"), element.child("position")
    if start is None or goal is None:
        raise DocumentError(f"the relative waypoint {element.get('name')} was never taught")
    name = identifier(element.get("name") or "Waypoint")
    if writer.once(f"relative waypoint {name}"):
        with writer.into("waypoints"):
            writer.line(f"global {name}_from_p={pose_text(taught_pose(start)[1])}")
            writer.line(f"global {name}_to_p={pose_text(taught_pose(goal)[1])}")
    return f"pose_add(get_target_tcp_pose(), pose_sub({name}_to_p, {name}_from_p))"


@node("CircleMove")
def circle_move(writer: Writer, element: Element) -> None:
    """An arc through one waypoint to another."""
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
    own = points[1].child("motionParameters")
    blend = _path_blend(writer, points[1], way, own.get("blendRadius") if own else "")
    mode = ", mode=1" if element.get("OrientationMode") == "FIXED" else ""
    writer.line(f"movec({via}, {end}, a={acceleration}, v={speed}, r={blend}{mode})")


@node("SafeHome")
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
