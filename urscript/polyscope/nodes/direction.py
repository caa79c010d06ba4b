"""Direction and Until nodes: move in a direction until a condition is met."""

from typing import Final

from urscript.polyscope.document import DocumentError, Element, make
from urscript.polyscope.expressions import lacks_expression
from urscript.polyscope.forms import (
    MILLI,
    Field,
    attribute_choice,
    attribute_number,
    child_number,
    expression_field,
    feature_field,
    of_type,
    parts_choice,
    pin_field,
)
from urscript.polyscope.nodes.motion import DIRECTION, move_of
from urscript.polyscope.nodes.waits import analog_condition, child_text
from urscript.polyscope.numbers import truth
from urscript.polyscope.registry import Kind, empty_children, node, translate_children
from urscript.polyscope.surroundings import DIGITAL_INPUTS, FEATURE_TITLES, Surroundings
from urscript.polyscope.writer import Writer, expression_label, expression_text, pin_reading
from urscript.work import Steps

_AXES: Final = {
    "XPlus": ("X+", "[1.0, 0.0, 0.0]"),
    "XMinus": ("X-", "[-1.0, 0.0, 0.0]"),
    "YPlus": ("Y+", "[0.0, 1.0, 0.0]"),
    "YMinus": ("Y-", "[0.0, -1.0, 0.0]"),
    "ZPlus": ("Z+", "[0.0, 0.0, 1.0]"),
    "ZMinus": ("Z-", "[0.0, 0.0, -1.0]"),
}
_EXPRESSION: Final = "expression"
_FAR: Final = "1000.0"  # m; PolyScope moves this far when there is no distance
_NO_RETRACTION: Final = "NONE"
_BLEND: Final = "BLEND"
_ENDS: Final = {"STOP": "Stop", _BLEND: "Blend"}
_RETREAT_SPEED: Final = "0.1"  # m/s
_FUNCTION: Final = "calculate_point_to_move_towards"  # PolyScope's name, because other lines of programs call it
_UNTILS: Final = {
    "DISTANCE": "A distance",
    "TOOL_CONTACT_DETECTION": "Tool contact",
    "EXPRESSION": "An expression",
    "IO": "A digital input",
}
_STOP: Final = {"decelerationAcceleration": "3.0", "decelerationAngularAcceleration": "34.90658503988659"}
_ATTRIBUTES: Final = {
    "DISTANCE": {"deceleration": "3.0", "distanceNodeType": "STOP"},
    "TOOL_CONTACT_DETECTION": {"retraction": "0.0", **_STOP},
    "EXPRESSION": _STOP,  # guess: no public file has one
    "IO": {"ioType": "DIGITAL_INPUT", "digitalValue": "1", **_STOP},  # guess, as well
}
_PARTS: Final = {
    "DISTANCE": [make("Distance", text="0.1"), make("motionParameters", blendRadius="0.0")],
    "EXPRESSION": [make("expression")],
}


def _by_expression(element: Element) -> bool:
    return element.child("expression") is not None


def _choose_direction(element: Element, value: str, program: Surroundings) -> None:
    """Choose an axis of the feature, or an expression for the vector."""
    by_expression = value == _EXPRESSION
    program.set_attribute(element, "selectedDirection", None if by_expression else value)
    if by_expression != _by_expression(element):
        program.set_child(element, "expression", make("expression") if by_expression else None)


def _direction_shown(element: Element) -> str:
    """The feature (that of the Move, unless the node has its own) and the axis, as shown in the tree."""
    around: Element | None = element
    while around is not None and around.child("feature") is None:
        around = around.parent
    name = around.named("feature") if around is not None else ""
    axis = "" if _by_expression(element) else _AXES.get(element.get("selectedDirection"), ("?",))[0]
    return f"Direction: {FEATURE_TITLES.get(name, name) or 'Base'} {axis}".rstrip()


DIRECTION_KIND: Final = Kind(
    "direction",
    "Direction",
    "Basic",
    _direction_shown,
    new=lambda program: make(DIRECTION, make("children", _new_until(program)), selectedDirection="ZPlus"),
    stands="move",
    contains="direction",
    undefined=lambda element: (
        "the direction to move in" if _by_expression(element) and lacks_expression(element) else ""
    ),
    fields=(
        Field(
            "direction",
            "Direction",
            "choice",
            lambda element, _: _EXPRESSION if _by_expression(element) else element.get("selectedDirection"),
            _choose_direction,
            choices=(*((key, shown) for key, (shown, _) in _AXES.items()), (_EXPRESSION, "An expression")),
        ),
        expression_field("expression", "Vector", shown=_by_expression),
        feature_field("feature", "Feature", optional=True, help="empty: the feature of the Move"),
    ),
)


@node(DIRECTION, DIRECTION_KIND, attributes="selectedDirection toolParams", children="expression feature children")
def direction(writer: Writer, element: Element) -> Steps[None]:
    """Move along an axis or a vector until a distance, a contact, an input or an expression ends it."""
    untils = [child for child in element.child("children") or () if child.tag == "Until"]
    untils.sort(key=lambda until: until.get("type") == "DISTANCE")  # PolyScope checks the distance last
    distance = untils[-1] if untils and untils[-1].get("type") == "DISTANCE" else None
    shown, vector = _direction(writer, element)
    number = writer.number(element)
    write_direction_function(writer)
    writer.label(element, f"Direction: {shown}")
    _write_thread(writer, element, number, vector, distance)
    writer.line(f"move_thread_flag_{number} = 0")
    writer.line(f"move_thread_han_{number} = run move_thread_{number}()")
    with writer.block("while (True):"):
        for until in untils:
            yield from _until(writer, until, number)
        writer.line("sync()")


def _direction(writer: Writer, element: Element) -> tuple[str, str]:
    """The direction as shown in the tree, and the URScript for its vector."""
    expression = element.child("expression")
    if expression is not None:
        return expression_label(writer, expression), expression_text(writer, expression)
    axis = _AXES.get(element.get("selectedDirection"))
    if axis is None:
        raise DocumentError(f"a Direction along an unknown axis {element.get('selectedDirection')!r}")
    return axis


def write_direction_function(writer: Writer) -> None:
    """Write the function that computes the pose at a distance from the arm in a direction of a feature."""
    if not writer.once("direction function"):
        return
    with writer.into("waypoints"), writer.block(f"def {_FUNCTION}(feature, direction, distance):"):
        writer.line("local axis=[direction[0], direction[1], direction[2]]")
        with writer.block("if (norm(axis) < 1e-6):"):
            writer.line("return get_target_waypoint()")
        writer.line("axis = normalize(axis)")
        writer.line("local step=p[axis[0] * distance, axis[1] * distance, axis[2] * distance, 0, 0, 0]")
        writer.line("return pose_add(get_target_waypoint(), pose_sub(pose_trans(feature, step), feature))")


def _write_thread(writer: Writer, element: Element, number: int, vector: str, distance: Element | None) -> None:
    """Write the motion as a thread, so that it can be ended. Without a distance, it continues until it is ended."""
    way = move_of(element)
    call = "movep" if way.kind == "MoveP" else "movel"  # also under MoveJ
    far = _FAR if distance is None else child_text(distance, "Distance")
    blend = ""
    if distance is not None and distance.get("distanceNodeType") == _BLEND:
        motion = distance.child("motionParameters")
        blend = f", r={motion.get('blendRadius')}" if motion else ""
    own = [part.strip() for part in element.get("toolParams").split(",")]
    speed, acceleration = own if len(own) == 2 else reversed(way.speeds(None))
    reference = element.child("feature")
    feature = writer.feature(reference if reference is not None else way.element.child("feature"))
    writer.line(f"global move_thread_flag_{number}=0")
    with writer.block(f"thread move_thread_{number}():"):
        writer.line("enter_critical")
        writer.line(f"move_thread_flag_{number} = 1")
        writer.line(f"local target={_FUNCTION}({feature}, {vector}, {far})")
        writer.line(f"{call}(target, a={acceleration}, v={speed}{blend})")
        writer.line(f"move_thread_flag_{number} = 2")
        writer.line("exit_critical")


def _until(writer: Writer, until: Element, number: int) -> Steps[None]:
    kind = until.get("type")
    if kind == "NONE":
        return
    if kind == "TOOL_CONTACT_DETECTION":
        yield from _contact(writer, until, number)
        return
    if kind == "DISTANCE":
        writer.line("sleep(1.0E-10)")
        condition = f"move_thread_flag_{number} > 1"
    else:
        condition = _condition(writer, until, kind)
    with writer.block(f"if ({condition}):"):
        if kind == "DISTANCE":
            writer.line(f"join move_thread_han_{number}")
        else:
            writer.line(f"kill move_thread_han_{number}")
            writer.line(f"stopl({_deceleration(writer, until)})")
        yield from _actions(writer, until, kind)


def _actions(writer: Writer, until: Element, kind: str) -> Steps[None]:
    writer.label(until, f"Until ({kind.lower()})")
    yield from translate_children(writer, until)
    writer.line("break")


def _condition(writer: Writer, until: Element, kind: str) -> str:
    if kind == "EXPRESSION":
        return expression_text(writer, until.child("expression"))
    if kind == "IO" and until.get("ioType") == "DIGITAL_INPUT":
        return f"{pin_reading(writer, until.child('pin'))} == {truth(until.get('digitalValue'))}"
    if kind == "IO":
        return analog_condition(writer, until)
    raise DocumentError(f"an Until of unknown type {kind!r}")


def _deceleration(writer: Writer, until: Element) -> str:
    """Deceleration [m/s2]: a number or an expression of the Until (its element is a guess), else that of the Move."""
    for child in until:
        if "eceleration" in child.tag and child.children:
            return expression_text(writer, child)
    given = until.get("decelerationAcceleration") or until.get("deceleration")
    return given or move_of(until).speeds(None)[0]


def _contact(writer: Writer, until: Element, number: int) -> Steps[None]:
    """Stop at a contact, and either stay or move back to where it happened and a little further."""
    stop = _deceleration(writer, until)
    back = until.get("retraction") or "0.0"
    writer.line("local contact_direction=get_target_tcp_speed()")
    writer.line("local contact_steps=tool_contact(direction=contact_direction)")
    with writer.block("if (contact_steps > 0):"):
        writer.line(f"kill move_thread_han_{number}")
        writer.line(f"stopl({stop})")
        if back != _NO_RETRACTION:
            _write_retraction(writer, stop, back)
        yield from _actions(writer, until, "TOOL_CONTACT_DETECTION")


def _write_retraction(writer: Writer, stop: str, back: str) -> None:
    writer.line("local contact_pose=get_forward_kin(get_actual_joint_positions_history(contact_steps))")
    writer.line("local contact_axis=[contact_direction[0], contact_direction[1], contact_direction[2]]")
    with writer.block("if (norm(contact_axis) > 1e-6):"):
        writer.line("contact_axis = normalize(contact_axis)")
        writer.line(
            "contact_pose = pose_sub(contact_pose, "
            f"p[contact_axis[0] * {back}, contact_axis[1] * {back}, contact_axis[2] * {back}, 0, 0, 0])"
        )
    writer.line(f"movel(contact_pose, a={stop}, v={_RETREAT_SPEED})")


def _new_until(_: Surroundings) -> Element:
    return make("Until", type="NONE", allowActions="false")


def _allow_actions(element: Element, value: bool, program: Surroundings) -> None:
    program.set_attribute(element, "allowActions", "true" if value else "false")
    if element.child("children") is None and value:
        program.set_child(element, "children", empty_children())
    elif not value:
        program.set_child(element, "children", None)


def _until_lacks(element: Element) -> str:
    kind = element.get("type")
    if kind in ("", "NONE"):
        return "what ends the movement"
    if kind == "EXPRESSION" and lacks_expression(element):
        return "the expression that ends the movement"
    return "the input that ends the movement" if kind == "IO" and element.child("pin") is None else ""


UNTIL: Final = Kind(
    "until",
    "Until",
    "Basic",
    lambda element: f"Until ({element.get('type').lower()})",
    new=_new_until,
    stands="direction",
    contains="nodes",
    undefined=_until_lacks,
    fields=(
        parts_choice("type", "Until", "type", _UNTILS, _PARTS, _ATTRIBUTES, ["allowActions", "children"]),
        child_number("distance", "Distance", "Distance", unit="mm", factor=MILLI, low=0.0, shown=of_type("DISTANCE")),
        attribute_choice("distance_end", "At the end", "distanceNodeType", _ENDS, shown=of_type("DISTANCE")),
        expression_field("expression", "Expression", shown=of_type("EXPRESSION")),
        pin_field("input", "Input", DIGITAL_INPUTS, shown=of_type("IO")),
        attribute_choice("level", "Level", "digitalValue", {"1": "High", "0": "Low"}, shown=of_type("IO")),
        attribute_number(
            "deceleration",
            "Deceleration",
            "decelerationAcceleration",
            unit="mm/s²",
            factor=MILLI,
            low=0.0,
            shown=of_type("TOOL_CONTACT_DETECTION", "EXPRESSION", "IO"),
            optional=True,
        ),
        Field("actions", "Add action", "boolean", lambda e, _: e.get("allowActions") == "true", _allow_actions),
    ),
)


@node(
    "Until",
    UNTIL,
    attributes="type allowActions deceleration distanceNodeType retraction ioType digitalValue "
    "decelerationAcceleration decelerationAngularAcceleration",
    children="Distance motionParameters pin expression children",
)
def until_node(writer: Writer, element: Element) -> None:
    """End condition of a Direction, which writes it."""
    raise DocumentError("an Until outside a Direction")
