"""``robot_description_semantic``: the arm's group, its named postures, and the links that are never looked at."""

from itertools import combinations
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from client.planning import NAMED_CONFIGURATIONS
from client.ros2.move_group.arm import GROUP, Arm
from client.ros2.move_group.scene import SceneState


def srdf(arm: Arm) -> str:
    """An SRDF of what is planned here, for the URDF that the robot_state_publisher has."""
    root = Element("robot", name=arm.model.name)
    group = SubElement(root, "group", name=GROUP)
    SubElement(group, "chain", base_link=arm.root, tip_link=arm.tip)
    for name, q_rad in NAMED_CONFIGURATIONS.items():
        state = SubElement(root, "group_state", name=name, group=GROUP)
        for joint, angle in zip(arm.joints, q_rad, strict=True):
            SubElement(state, "joint", name=joint, value=repr(angle))
    scene = SceneState(arm)
    for one, other in combinations(arm.solid, 2):
        if scene.always_touch(one, other):
            beside = arm.solid.index(other) - arm.solid.index(one) == 1
            SubElement(root, "disable_collisions", link1=one, link2=other, reason="Adjacent" if beside else "Never")
    indent(root)
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'
