"""The world model, against homogeneous matrices worked out by numpy."""

import numpy as np
import pytest

from tests.rows import each_row

RNG = np.random.default_rng(7)


def matrix(pose):
    """4x4 of a pose, by Rodrigues' formula."""
    t, r = np.array(pose[:3]), np.array(pose[3:])
    angle = np.linalg.norm(r)
    k = np.zeros((3, 3))
    if angle:
        x, y, z = r / angle
        k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    m = np.eye(4)
    m[:3, :3] = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
    m[:3, 3] = t
    return m


def text(pose):
    return f"p[{', '.join(f'{v:.17g}' for v in pose)}]"


def random_pose():
    return [*RNG.uniform(-1, 1, 3), *RNG.uniform(-1.5, 1.5, 3)]


def close(pose, expected):
    np.testing.assert_allclose(matrix(pose), expected, atol=1e-9)


def test_predefined_frames_follow_the_arm(rig):
    rig.run("set_tcp(p[0.01, 0.02, 0.1, 0, 0.5, 0])\nmovej([0.3, -1.2, 1.1, -1.6, -1.57, 0.4], t=0.5)")
    flange, tcp = rig.value("get_actual_tool_flange_pose()"), rig.value("get_actual_tcp_pose()")
    close(rig.value('get_pose("flange", "base")'), matrix(flange))
    close(rig.value('get_pose("tcp", "base")'), matrix(tcp))
    close(rig.value('get_pose("tcp", "flange")'), matrix([0.01, 0.02, 0.1, 0, 0.5, 0]))
    close(rig.value('get_pose("base", "world")'), np.eye(4))
    assert rig.value('[get_frame_parent("tcp"), get_frame_parent("flange"), get_frame_parent("base")]') == [
        "flange",
        "base",
        "world",
    ]


def test_poses_between_frames(rig):
    base, a, b, given = random_pose(), random_pose(), random_pose(), random_pose()
    rig.run(f'move_frame("base", {text(base)}, "world")\nadd_frame("a", {text(a)})\nadd_frame("b", {text(b)}, "a")')
    w_a = matrix(base) @ matrix(a)
    w_b = w_a @ matrix(b)
    close(rig.value('get_pose("a", "world")'), w_a)
    close(rig.value('get_pose("b", "world")'), w_b)
    close(rig.value('get_pose("a", "b")'), np.linalg.inv(matrix(b)))
    close(rig.value(f'convert_pose({text(given)}, "b", "base")'), matrix(a) @ matrix(b) @ matrix(given))
    close(rig.value(f'convert_pose({text(given)}, "base", "b")'), np.linalg.inv(matrix(a) @ matrix(b)) @ matrix(given))


def test_a_relative_pose_in_the_coordinates_of_a_third_frame(rig):
    a, b, c = random_pose(), random_pose(), random_pose()
    rig.run("\n".join(f'add_frame("{name}", {text(pose)})' for name, pose in zip("abc", (a, b, c), strict=True)))
    a, b, c = matrix(a), matrix(b), matrix(c)
    expected = np.eye(4)
    expected[:3, 3] = c[:3, :3].T @ (a[:3, 3] - b[:3, 3])
    expected[:3, :3] = c[:3, :3].T @ (a[:3, :3] @ b[:3, :3].T) @ c[:3, :3]
    close(rig.value('get_pose("a", "b", "c")'), expected)


def test_an_attached_frame_moves_with_the_arm_and_a_detached_one_does_not(rig):
    part = random_pose()
    rig.run(f'add_frame("part", {text(part)}, "tcp")\nadd_frame("loose", {text(part)}, "tcp")')
    before = rig.value('get_pose("part", "base")')
    rig.run('attach_frame("part", "tcp")')
    close(rig.value('get_pose("part", "base")'), matrix(before))
    rig.run("movej([0.5, -1.0, 1.2, -1.0, -1.2, 0.3], t=0.5)")
    close(rig.value('get_pose("part", "tcp")'), matrix(part))
    close(rig.value('get_pose("loose", "base")'), matrix(before))
    assert np.linalg.norm(np.subtract(rig.value('get_pose("part", "base")')[:3], before[:3])) > 0.1


def test_moving_a_frame_moves_its_children_and_keeps_its_parent(rig):
    table, part, elsewhere = random_pose(), random_pose(), random_pose()
    rig.run(
        f'add_frame("table", {text(table)})\nadd_frame("part", {text(part)}, "table")\n'
        f'attach_frame("part", "table")\nmove_frame("table", {text(elsewhere)}, "flange")'
    )
    close(rig.value('get_pose("table", "flange")'), matrix(elsewhere))
    close(rig.value('get_pose("part", "table")'), matrix(part))
    assert rig.value('get_frame_parent("table")') == "world"
    assert rig.value('get_children("table")') == ["part"]


def test_deleting_a_frame_leaves_its_children_in_the_world(rig):
    rig.run(
        'add_frame("table", p[1, 0, 0, 0, 0, 1])\nadd_frame("part", p[0, 1, 0, 0, 0, 0], "table")\n'
        'attach_frame("part", "table")'
    )
    before = rig.value('get_pose("part", "world")')
    rig.run('delete_frame("table")')
    assert rig.value('[is_frame("table"), is_frame("part")]') == [False, True]
    assert rig.value('get_frame_parent("part")') == "world"
    close(rig.value('get_pose("part", "world")'), matrix(before))


def test_the_base_on_a_rail_survives_delete_all_and_is_reset(rig):
    rig.run('add_frame("rail", p[2, 0, 0, 0, 0, 0])\nattach_frame("base", "rail")')
    rig.run('move_frame("rail", p[3, 0, 0, 0, 0, 0], "world")')
    assert rig.value('get_pose("flange", "world")')[0] == pytest.approx(rig.value('get_pose("flange", "base")')[0] + 1)
    rig.run("delete_all_frames()")
    assert rig.value('get_frame_parent("base")') == "world"
    close(rig.value('get_pose("base", "world")'), matrix([1, 0, 0, 0, 0, 0]))
    rig.run("reset_world_model()")
    close(rig.value('get_pose("base", "world")'), np.eye(4))
    assert rig.value('get_children("world")') == ["base"]


@each_row(
    ("body", "problem"),
    [
        ('add_frame("tcp", p[0,0,0,0,0,0])', "already"),
        ('add_frame("", p[0,0,0,0,0,0])', "name"),
        ('add_frame("a", p[0,0,0,0,0,0], "nowhere")', 'no frame "nowhere"'),
        ('attach_frame("tcp", "world")', "cannot be attached"),
        ('attach_frame("flange", "world")', "cannot be attached"),
        ('attach_frame("base", "tcp")', "moves along with it"),
        ('add_frame("a", p[0,0,0,0,0,0])\nattach_frame("a", "a")', "moves along with it"),
        ('move_frame("tcp", p[0,0,0,0,0,0])', "set_tcp()"),
        ('delete_frame("base")', "cannot be deleted"),
        ('get_frame_parent("world")', "no parent"),
        ('set_mass_properties("nowhere", 1, [0,0,0], [0,0,0,0,0,0])', 'no frame "nowhere"'),
        ('set_mass_properties("tcp", -1, [0,0,0], [0,0,0,0,0,0])', "mass"),
        ('set_mass_properties("tcp", 1, [0,0,0], [-1,0,0,0,0,0])', "0 or more"),
        ('i = 0\nwhile True:\n  add_frame(str_cat("f", i), p[0,0,0,0,0,0])\n  i = i + 1\nend', "100 frames"),
    ],
)
def test_invalid_calls_are_reported_and_change_nothing(rig, body, problem):
    frames = rig.value('get_children("world")')
    assert problem in rig.fault(body)
    assert rig.value('get_children("world")')[: len(frames)] == frames


def test_payload_of_attached_frames(rig):
    tcp, offset = [0, 0, 0.1, 0, 0, 0.7], random_pose()
    rig.run(
        f"set_tcp({text(tcp)})\n"
        'set_mass_properties("tcp", 1.5, [0.01, 0.02, 0.03], [0.01, 0.02, 0.03, 0.001, 0.002, 0.003])\n'
        f'add_frame("part", {text(offset)}, "tcp")\nattach_frame("part", "tcp")\n'
        'set_mass_properties("part", 0.5, [0.1, 0, 0], [0.005, 0.005, 0.001, 0, 0, 0])\n'
        'add_frame("table", p[0, 0, 0, 0, 0, 0])\nset_mass_properties("table", 50, [0, 0, 0], [1, 1, 1, 0, 0, 0])\n'
        "set_payload_from_attached_frames()"
    )
    bodies = [
        (1.5, matrix(tcp), np.array([0.01, 0.02, 0.03]), _tensor(0.01, 0.02, 0.03, 0.001, 0.002, 0.003)),
        (0.5, matrix(tcp) @ matrix(offset), np.array([0.1, 0, 0]), _tensor(0.005, 0.005, 0.001, 0, 0, 0)),
    ]
    centres = [(m @ [*cog, 1])[:3] for _, m, cog, _ in bodies]
    centre = (1.5 * centres[0] + 0.5 * centres[1]) / 2.0
    inertia = np.zeros((3, 3))
    for (mass, m, _, tensor), at in zip(bodies, centres, strict=True):
        d = at - centre
        inertia += m[:3, :3] @ tensor @ m[:3, :3].T + mass * (d @ d * np.eye(3) - np.outer(d, d))
    assert rig.value("get_target_payload()") == pytest.approx(2.0)
    np.testing.assert_allclose(rig.value("get_target_payload_cog()"), centre, atol=1e-12)
    expected = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    np.testing.assert_allclose(rig.value("get_target_payload_inertia()"), expected, atol=1e-12)


def _tensor(xx, yy, zz, xy, xz, yz):
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def test_a_detached_part_is_no_longer_payload(rig):
    rig.run(
        'add_frame("part", p[0, 0, 0.1, 0, 0, 0], "tcp")\n'
        'set_mass_properties("part", 2, [0, 0, 0], [0, 0, 0, 0, 0, 0])\n'
        'attach_frame("part", "tcp")\nset_payload_from_attached_frames()'
    )
    assert rig.value("get_target_payload()") == pytest.approx(2)
    rig.run('attach_frame("part", "world")\nset_payload_from_attached_frames()')
    assert rig.value("get_target_payload()") == 0


def test_the_world_model_does_not_exist_on_cb3(cb3):
    cb3.start('textmsg(is_frame("base"))')
    cb3.tick(5)
    assert "compile_error_name_not_found:is_frame:" in cb3.exceptions[-1].text
