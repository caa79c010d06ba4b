"""Links in contact load only the joints before them."""

from math import pi

import numpy as np
import pinocchio as pin
import pytest

from emulator.world.links import Links
from emulator.world.shapes import Box, Plane, Sphere, WorldObject
from tests.rows import each_row
from urproto.robots import MODELS, load_model
from urproto.robots.shapes import ArmCapsules, capsules, link_parts

POSTURES = [(0.3, -1.2, 1.4, -1.9, -1.1, 0.4), (-2.0, -0.4, -1.1, 0.7, 1.9, -0.6)]


@each_row("model", MODELS)
@each_row("q", POSTURES)
def test_axes_run_along_the_links(model, q):
    """The wrists' axes end where the Denavit-Hartenberg frames 4 and 5 are; tubes are as long as the table says."""
    robot = load_model(model)
    dh, place = robot.dh, pin.SE3.Identity()
    origins = []
    for i in range(6):
        turn = pin.SE3(pin.utils.rotate("z", q[i]), np.array((0.0, 0.0, dh.d[i])))
        link = pin.SE3(pin.utils.rotate("x", dh.alpha[i]), np.array((dh.a[i], 0.0, 0.0)))
        place = place * turn * link
        origins.append(place.translation)
    base, upper, fore, wrist_1, wrist_2, wrist_3 = ArmCapsules(robot).axes(q)
    assert base == ((0.0, 0.0, 0.0), pytest.approx(origins[0], abs=1e-8))
    assert np.linalg.norm(np.subtract(*upper)) == pytest.approx(abs(dh.a[1]))
    assert np.linalg.norm(np.subtract(*fore)) == pytest.approx(abs(dh.a[2]))
    assert wrist_1[1] == pytest.approx(origins[3], abs=1e-8)
    assert wrist_2 == (pytest.approx(origins[3], abs=1e-8), pytest.approx(origins[4], abs=1e-8))
    assert wrist_3 == (pytest.approx(origins[4], abs=1e-8), pytest.approx(origins[5], abs=1e-8))


@each_row("model", MODELS)
def test_link_radii_agree_in_collisions_description_and_pendant(model):
    """In collisions, in the description for planners and on the pendant."""
    robot = load_model(model)
    described = [capsule.radius for capsule in capsules(robot)]
    assert list(ArmCapsules(robot).radii) == [described[0], *described[2:]]
    drawn = [max(radius for part in parts for radius, _ in part.profile) for parts in link_parts(robot)]
    # housings are drawn with rims; those of the last link are 6 % narrower
    assert drawn[2:6] == pytest.approx([described[2], *described[3:6]], rel=0.02)


@pytest.fixture
def arm(make):
    """A UR5e whose links touch."""
    rig = make("ur5e")
    rig.world.links = Links(rig.controller.model)
    return rig


def extra(rig):
    """Joint torques in addition to those of the arm's model."""
    return [a - t for a, t in zip(rig.now.actual_current_as_torque, rig.now.target_moment, strict=True)]


def test_a_post_under_the_forearm_loads_the_joints_before_it(arm):
    start, end = ArmCapsules(arm.controller.model).axes(arm.now.actual_q)[2]
    middle = [0.5 * (a + b) for a, b in zip(start, end, strict=True)]
    radius = ArmCapsules(arm.controller.model).radii[2]
    post = WorldObject(Sphere(0.05), (middle[0], middle[1], middle[2] - radius - 0.049, 0, 0, 0), stiffness=1e5)
    arm.world.add("post", post)
    arm.tick(2)
    assert arm.force == (0.0,) * 6
    torques = extra(arm)
    assert torques[3:] == pytest.approx([0, 0, 0], abs=1e-9)
    # 100 N up, half a forearm from the elbow and that from the shoulder; the arm's plane is x-z, its axes point to -y
    assert abs(torques[2]) == pytest.approx(100 * abs(middle[0] - start[0]), rel=0.02)
    assert abs(torques[1]) == pytest.approx(100 * abs(middle[0]), rel=0.02)
    arm.world.remove("post")
    arm.tick(2)
    assert extra(arm) == [0.0] * 6


@pytest.mark.parametrize("shape", [Plane(), Box((0.4, 0.4, 0.4)), Sphere(0.2)])
def test_the_power_of_a_push_agrees_with_the_joint_torques(arm, shape):
    """Virtual work: the joint torques are the gradient of the spring's energy along each of them."""
    links = arm.world.links
    q = list(arm.now.actual_q)
    arm_capsules = ArmCapsules(arm.controller.model)
    start, end = arm_capsules.axes(q)[2]
    x, y, z = (0.5 * (a + b) for a, b in zip(start, end, strict=True))
    below = {Plane: 0.0, Box: 0.2, Sphere: 0.2}[type(shape)]
    place = (x, y, z - arm_capsules.radii[2] - below + 0.002, 0.1, 0.2, 0.0)
    obj = WorldObject(shape, place, stiffness=2e4, damping=0.0)
    links.surround([obj])

    def spring_energy(q):
        return sum(0.5 * obj.stiffness * touching.depth**2 for touching in links.touches(q))

    torques = links.torques(tuple(q), (0.0,) * 6)
    for joint in range(4):
        more, less = ([*q[:joint], q[joint] + step, *q[joint + 1 :]] for step in (1e-6, -1e-6))
        gradient = (spring_energy(more) - spring_energy(less)) / 2e-6
        assert torques[joint] == pytest.approx(-gradient, rel=2e-3, abs=2e-3)
    assert max(map(abs, torques)) > 1.0


def test_resting_the_upper_arm_on_a_block_overloads_a_joint(arm):
    """The tool is far beyond the block; the upper arm is not."""
    arm.world.add("block", WorldObject(Box((0.2, 0.6, 0.1)), (0.3, 0.0, 0.08, 0, 0, 0), stiffness=1e5))
    arm.motion.commands.movej((0.0, -pi, 0.0, 0.0, 0.0, 0.0), a=1.0, v=0.5)
    arm.until(lambda: arm.now.collision_detection_ratio == 1.0)
    assert arm.force == (0.0,) * 6
