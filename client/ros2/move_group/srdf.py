"""``robot_description_semantic``: the arm's group, its named configurations, and the pairs of links that are never
checked.
"""

from itertools import combinations
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from client.planning import NAMED_CONFIGURATIONS
from client.ros2.move_group.arm import GROUP, Arm
from client.ros2.move_group.scene import SceneState


def srdf(arm: Arm) -> str:
    """The SRDF that matches this planner, for the URDF of the robot_state_publisher."""
    root = Element("robot", name=arm.model.name)
    group = SubElement(root, "group", name=GROUP)
    SubElement(group, "chain", base_link=arm.root, tip_link=arm.tip)
    for name, q_rad in NAMED_CONFIGURATIONS.items():
        state = SubElement(root, "group_state", name=name, group=GROUP)
        for joint, angle in zip(arm.joints, q_rad, strict=True):
            SubElement(state, "joint", name=joint, value=repr(angle))
    scene = SceneState(arm)
    for one, other in combinations(arm.collision_links, 2):
        if scene.is_collision_disabled(one, other):
            adjacent = arm.collision_links.index(other) - arm.collision_links.index(one) == 1
            SubElement(root, "disable_collisions", link1=one, link2=other, reason="Adjacent" if adjacent else "Never")
    indent(root)
    return f'<?xml version="1.0"?>\n{tostring(root, encoding="unicode")}\n'
