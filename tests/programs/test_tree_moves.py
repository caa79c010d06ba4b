"""Move, Direction and Force nodes of program trees, tested by final positions of the arm."""

import math

import pytest
from tree_rig import (
    BASE,
    HOME,
    TOOL,
    Arm,
    assign,
    children,
    expression,
    installation,
    line,
    main,
    move,
    pin,
    tag,
    textmsg,
    urp,
    waypoint,
)

from tests.rows import each_row
from urproto.modes import SafetyMode
from urproto.robots import load_model
from urproto.robots.kinematics import Kinematics
from urproto.robots.pose import pose_dist, pose_trans
from urproto.signals import STANDARD
from urscript.polyscope.document import read_document
from urscript.polyscope.installation_file import InstallationFile
from urscript.polyscope.program import script_steps
from urscript.polyscope.tree import ProgramTree
from urscript.work import run_to_end

ASIDE = (0.3, -1.4, 1.4, -1.5, -1.5, 0.2)
BACK = (0.0, -1.6, 1.6, -1.6, -1.57, 0.0)
DIRECTION = "gui.program.direction.MoveDirectionNode"


@pytest.fixture
def arm(tmp_path):
    return Arm(tmp_path)


def flange(q):
    return Kinematics(load_model("ur5e").dh).forward(q)


def distance_of(until="DISTANCE", blend="0.0", **attributes):
    return tag("Until", tag("Distance", "0.05"), tag("motionParameters", blendRadius=blend), type=until, **attributes)


@pytest.mark.parametrize("kind", ["MoveJ", "MoveL", "MoveP"])
def test_moves_reach_the_waypoints_taught(arm, kind):
    arm.play(move(waypoint(ASIDE), waypoint(BACK, "Waypoint_2"), kind=kind))
    assert arm.q == pytest.approx(BACK, abs=1e-3)


def test_a_move_to_joint_angles(arm):
    turned = (*BACK[:5], 6.0)
    arm.play(move(waypoint(turned), positionType="JointAngles", speed=3.0, acceleration=10))
    assert arm.q == pytest.approx(turned, abs=1e-3)


def test_a_waypoint_with_a_time_or_speed(arm):
    timed = arm.play(move(waypoint(ASIDE, nextMotionTime="2.5")))
    assert timed == pytest.approx(2.5, abs=0.1)
    slow = arm.play(move(waypoint(HOME, "Waypoint_2", jointSpeed="0.1", jointAcceleration="1.4")))
    assert slow == pytest.approx(0.3 / 0.1, abs=0.3)


def test_waypoints_with_a_blend_do_not_stop(arm):
    stops = arm.play(move(waypoint(ASIDE), waypoint(BACK, "Waypoint_2"), waypoint(HOME, "Waypoint_3")))
    blends = arm.play(
        move(
            waypoint(ASIDE, blendRadius="0.02"),
            waypoint(BACK, "Waypoint_2", blendRadius="0.02"),
            waypoint(HOME, "Waypoint_3"),
        )
    )
    assert blends < stops


def test_a_waypoint_in_a_variable_and_a_relative_one(arm):
    start = arm.pose
    up = tag("Waypoint", tag("motionParameters"), tag("variable", name="goal"), type="Variable", name="Waypoint")
    taught = waypoint(HOME).split("<position>")[1].split("</position>")[0]
    relative = (
        waypoint(ASIDE)
        .replace('type="Fixed"', 'type="Relative"')
        .replace("<BaseToFeature", tag("relativeFromPosition", taught) + "<BaseToFeature")
    )
    arm.play(assign("goal", "pose_add(get_target_tcp_pose(), p[0, 0, 0.03, 0, 0, 0])"), move(up, kind="MoveL"))
    assert arm.pose[2] == pytest.approx(start[2] + 0.03, abs=1e-4)
    arm.play(move(waypoint(HOME), relative, kind="MoveL"))
    assert pose_dist(arm.pose, flange(ASIDE)) < 1e-3


def variable_table(arm):
    """A cell with a variable feature, at y = 0.25 m; the element that refers to it."""
    feature = tag(
        "GeomPoseNode",
        tag("toolPosition", value="0.1, 0.25, 0.0"),
        tag("toolAxisAngle", value="0.0, 0.0, 0.0"),
        name="table",
        isVariable="true",
    )
    (arm.folder / "cell.installation").write_text(installation(tag("Features", tag("GeomPoseNode", feature))))
    return '<feature class="GeomFeatureReference" referencedName="table"/>'


def test_waypoints_follow_a_variable_feature(arm):
    """The feature was moved 0.05 m along y since the waypoint was taught."""
    on_table = variable_table(arm)
    arm.play(move(waypoint(BACK, feature="0.1, 0.2, 0.0, 0.0, 0.0, 0.0"), feature=on_table), installation="cell")
    assert pose_dist(arm.pose, pose_trans((0.0, 0.05, 0.0, 0.0, 0.0, 0.0), flange(BACK))) < 1e-3


def test_a_direction_uses_a_variable_feature_as_saved(arm):
    """PolyScope writes its pose, never its name: 2,236 places in public scripts."""
    on_table = variable_table(arm)
    up = tag(DIRECTION, children(distance_of()), selectedDirection="ZPlus")
    start = arm.pose
    arm.play(
        assign("table", "p[0, 0, 0, 3.14159265, 0, 0]"), move(up, kind="MoveL", feature=on_table), installation="cell"
    )
    assert arm.pose[2] == pytest.approx(start[2] + 0.05, abs=2e-3)


@pytest.mark.parametrize("feature", [BASE, ""], ids=["the base as its feature", "no feature"])
def test_a_variable_waypoint_follows_a_variable_base(arm, feature):
    """Seen in public scripts of 3.15: with <feature> pose_trans(Base, ...), without it the variable alone."""
    view = tag("BaseView", tag("BaseView", isVariable="true"))
    (arm.folder / "cell.installation").write_text(installation(tag("Features", view)))
    goal = tag("Waypoint", tag("variable", name="goal"), tag("motionParameters"), type="Variable")
    start = arm.pose
    arm.play(
        assign("goal", "get_actual_tcp_pose()"),
        assign("Base", "p[0, 0, 0.03, 0, 0, 0]"),
        move(goal, kind="MoveL", feature=feature),
        installation="cell",
    )
    assert arm.pose[2] == pytest.approx(start[2] + (0.03 if feature else 0.0), abs=1e-3)


def test_the_tcp_of_a_move_and_of_a_set(arm):
    tcps = '<tcp name="TCP" offset="0, 0, 0.1, 0, 0, 0"/><tcp name="Long" offset="0, 0, 0.02, 0, 0, 0"/>'
    (arm.folder / "cell.installation").write_text(installation(tcps=tcps))
    long = tag("tcp", referencedName="Long")
    report = line('textmsg("", get_tcp_offset()[2])')
    arm.play(
        report,
        move(waypoint(ASIDE), tcp=long),
        report,
        tag("Set", tag("tcp", referencedName="TCP"), type="NoAction"),
        report,
        installation="cell",
    )
    assert arm.texts == ["0.1", "0.02", "0.1"]


def written(*nodes):
    """URScript of a robot program with these nodes: its lines that move, stop or set the TCP."""
    tree = ProgramTree(read_document(urp(main(*nodes))), "tree")
    file = InstallationFile(tcp=(0.0,) * 6, tcps={"Long": (0.0, 0.0, 0.3, 0.0, 0.0, 0.0)})
    words = ("move", "stop", "set_tcp", "if CONTACT")
    lines = [text.strip() for text in run_to_end(script_steps(tree, file)).splitlines()]
    return [text for text in lines if text.startswith(words) and not text.startswith("move_thread")][1:]


def test_polyscope_sets_the_tcp_of_a_move_before_each_waypoint_but_not_for_joint_angles():
    """Seen in 770 waypoints of public pairs."""
    long = tag("tcp", referencedName="Long")
    two = (waypoint(ASIDE), waypoint(BACK, "Waypoint_2"))
    assert [text.split("(")[0] for text in written(move(*two, tcp=long))] == ["set_tcp", "movej"] * 2
    assert [text.split("(")[0] for text in written(move(*two, tcp=long, positionType="JointAngles"))] == ["movej"] * 2


def test_a_move_without_any_tcp_moves_the_flange():
    """Seen in a public pair: the pose is extended by the offset of the TCP in use."""
    assert "pose_trans(Waypoint_1_p, get_tcp_offset())" in written(move(waypoint(ASIDE), useActiveTCP="false"))[0]


@pytest.mark.parametrize(
    ("active", "target"), [("false", "pose_trans(p[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], goal)"), ("true", "goal")]
)
def test_a_variable_waypoint_that_ignores_the_active_tcp_is_only_put_into_the_base(active, target):
    """Seen in two public pairs, PolyScope 3.5.4 and 3.15.8."""
    goal = tag("Waypoint", tag("motionParameters"), tag("variable", name="goal"), type="Variable")
    (line_written,) = written(assign("goal", "p[0, 0, 0, 0, 0, 0]"), move(goal, kind="MoveL", useActiveTCP=active))
    assert line_written.startswith(f"movel({target}, ")


def test_before_5_0_a_movej_goes_to_the_pose_with_the_active_tcp_and_else_to_the_joints():
    """Seen in public pairs of 3.10 to 3.15."""
    old = {"positionType": ""}
    assert "get_inverse_kin" in written(move(waypoint(ASIDE), **old))[0]
    assert "get_inverse_kin" not in written(move(waypoint(ASIDE), useActiveTCP="false", **old))[0]


@each_row(
    ("after", "blend"),
    [
        ((), "0.02"),
        ((move(waypoint(ASIDE, "next"), kind="MoveL"),), "0.0"),
        ((move(waypoint(ASIDE, "next"), kind="MoveP"),), "0.02"),
        ((move(tag(DIRECTION, children(distance_of()), selectedDirection="ZPlus"), kind="MoveL"),), "0.02"),
        ((textmsg("between"), move(waypoint(ASIDE, "next"), kind="MoveL")), "0.02"),
    ],
    ids=["the end", "MoveL", "MoveP", "a Direction", "something between"],
)
def test_a_path_keeps_its_blend_unless_a_move_of_another_kind_follows(after, blend):
    """Seen in 700 MoveP of public pairs."""
    first, *_ = written(move(waypoint(BACK), kind="MoveP", blendRadius="0.02"), *after)
    assert first.endswith(f"r={blend})")


def test_how_a_direction_moves_and_stops():
    """The Move's acceleration is used to stop if the Until has none; a distance is checked last, and may blend; MoveP
    moves by movep (all seen in public pairs). No retraction: guess."""

    def direction(*untils, kind="MoveL", **attributes):
        node = tag(DIRECTION, children(*untils), selectedDirection="ZPlus", **attributes)
        return written(move(node, kind=kind, acceleration=0.5))

    contact = tag("Until", type="TOOL_CONTACT_DETECTION", retraction="0.001")
    lines = direction(distance_of(), contact, toolParams="0.01, 0.8")
    assert lines == ["movel(target, a=0.8, v=0.01)", "stopl(0.5)", "movel(contact_pose, a=0.5, v=0.1)"]
    assert direction(tag("Until", type="TOOL_CONTACT_DETECTION", retraction="NONE"))[1:] == ["stopl(0.5)"]
    assert direction(distance_of(), kind="MoveP")[0].startswith("movep(target")
    blended = distance_of(blend="0.05", distanceNodeType="BLEND")
    assert direction(blended)[0].endswith(", r=0.05)")


def test_a_direction_starts_where_the_previous_one_was_stopped(arm):
    """get_target_waypoint is the pose of the path again once a movement has been stopped."""

    def until(condition):
        return children(tag("Until", expression(condition), type="EXPRESSION"))

    z = arm.pose[2]
    up = tag(DIRECTION, until(f"get_actual_tcp_pose()[2] > {z + 0.03}"), selectedDirection="ZPlus")
    down = tag(DIRECTION, until(f"get_actual_tcp_pose()[2] < {z - 0.01}"), selectedDirection="ZMinus")
    arm.play(move(up, down, kind="MoveL"))
    assert arm.pose[2] < z - 0.01


def test_an_arc(arm):
    """Half a circle of 0.05 m radius in the horizontal plane around a point next to the tool."""
    start = arm.pose

    def point(name):
        return tag("Waypoint", tag("motionParameters"), tag("variable", name=name), type="Variable", name=name)

    circle = tag("CircleMove", children(point("via"), point("goal")), OrientationMode="FIXED")
    arm.play(
        assign("via", "pose_add(get_target_tcp_pose(), p[0.05, 0.05, 0, 0, 0, 0])"),
        assign("goal", "pose_add(get_target_tcp_pose(), p[0, 0.1, 0, 0, 0, 0])"),
        move(circle, kind="MoveP"),
    )
    assert arm.pose[:3] == pytest.approx((start[0], start[1] + 0.1, start[2]), abs=1e-3)
    assert pose_dist(arm.pose, (*start[:3], *arm.pose[3:])) == pytest.approx(0.1, abs=1e-3)


def test_the_home_position(arm):
    (arm.folder / "cell.installation").write_text(
        installation(tag("SafeHomeSettings", position=", ".join(map(str, ASIDE)), enabled="true"))
    )
    home = tag(
        "SafeHome", positionOptionType="SPEED_AND_ACCELERATION", speed="1.0", acceleration="1.0", nextMotionTime="2"
    )
    arm.play(home, installation="cell")
    assert arm.q == pytest.approx(ASIDE, abs=1e-3)


@pytest.mark.parametrize(
    ("feature", "axis", "moved"),
    [(BASE, "ZPlus", (0, 0, 0.05)), (BASE, "YMinus", (0, -0.05, 0)), (TOOL, "ZPlus", (0, 0, -0.05))],
)
def test_a_direction_until_a_distance(arm, feature, axis, moved):
    start = arm.pose
    arm.play(
        move(tag(DIRECTION, children(distance_of()), selectedDirection=axis), kind="MoveL", feature=feature),
        textmsg("on"),
    )
    assert arm.pose[:3] == pytest.approx([s + m for s, m in zip(start, moved, strict=False)], abs=2e-3)
    assert arm.texts == ["on"]


def test_a_direction_as_a_vector_with_a_speed(arm):
    start = arm.pose
    took = arm.play(
        move(tag(DIRECTION, expression("[3, 4, 0]"), children(distance_of()), toolParams="0.02, 1.2"), kind="MoveL")
    )
    assert arm.pose[:2] == pytest.approx([start[0] + 0.03, start[1] + 0.04], abs=1e-3)
    assert took == pytest.approx(0.05 / 0.02, rel=0.1)


def test_a_direction_until_an_input_or_an_expression(arm):
    far = tag(
        "Until",
        tag("children", textmsg("stopped")),
        pin("digital_in[1]"),
        type="IO",
        ioType="DIGITAL_INPUT",
        digitalValue="true",
    )
    start = arm.pose
    arm.start(
        tag(
            "MainProgram",
            children(move(tag(DIRECTION, children(far), selectedDirection="ZPlus"), kind="MoveL")),
            runOnlyOnce="true",
        )
    )
    arm.until(lambda: arm.pose[2] > start[2] + 0.03)
    arm.controller.signals.set_digital_input(STANDARD, 1, True)
    arm.until(lambda: arm.texts == ["stopped"])
    assert math.isclose(arm.pose[2], start[2] + 0.03, abs_tol=0.03)
    high = f"get_actual_tcp_pose()[2] < {start[2]}"
    down = tag("Until", expression(high), type="EXPRESSION")
    arm.play(move(tag(DIRECTION, children(down), selectedDirection="ZMinus"), kind="MoveL"), textmsg("down"))
    assert arm.pose[2] == pytest.approx(start[2], abs=0.03)
    assert arm.texts[-1] == "down"


def test_a_direction_until_a_contact_or_a_distance_ends_at_the_first(arm):
    contact = tag("Until", type="TOOL_CONTACT_DETECTION", retraction="0.005", decelerationAcceleration="3.0")
    start = arm.pose
    arm.play(move(tag(DIRECTION, children(contact, distance_of()), selectedDirection="YPlus"), kind="MoveL"))
    assert arm.pose[1] == pytest.approx(start[1] + 0.05, abs=2e-3)


def test_an_endless_direction_goes_as_far_as_the_arm_reaches(arm):
    start = arm.pose
    arm.start(main(move(tag(DIRECTION, children(tag("Until", type="NONE")), selectedDirection="ZPlus"), kind="MoveL")))
    arm.until(lambda: arm.controller.safety.mode is SafetyMode.PROTECTIVE_STOP)
    assert arm.pose[2] > start[2] + 0.2


def test_force_nodes_begin_and_end_force_mode(arm):
    force = tag(
        "Force",
        TOOL,
        tag("selection", value="0, 0, 1, 0, 0, 0"),
        tag("wrench", value="0.0, 0.0, 5.0, 0.0, 0.0, 0.0"),
        tag("limitsForce", value="0.15, 0.15, 0.15, 1.0, 1.0, 1.0"),
        tag("limitsMotion", value="0.1, 0.1, 0.1, 0.3, 0.3, 0.3"),
        children(tag("Wait", tag("waitTime", "0.5"), type="Sleep")),
        type="Simple",
    )
    start = arm.pose
    arm.play(force)
    pressed = arm.pose
    assert pressed[2] < start[2] - 0.005  # nothing blocks the tool, which points down
    arm.seconds(0.5)
    assert pose_dist(arm.pose, pressed) < 0.02
