"""Names of ROS 2, and what DDS calls the same things.

Source: the design article "Topic and Service name mapping to DDS", and rosidl's name of types on DDS.
"""

import re
from typing import Final

from client.errors import Ros2Error

__all__ = ["check_namespace", "check_prefix", "dds_topic", "dds_type", "resolved"]

_TOPIC: Final = "rt"  # in front of topics; services have others
_NAMESPACE: Final = re.compile(r"(/[A-Za-z_]\w*)*", re.ASCII)
_PREFIX: Final = re.compile(r"([A-Za-z_][\w/]*)?", re.ASCII)


def dds_topic(name: str) -> str:
    """``/joint_states`` is the DDS topic ``rt/joint_states``."""
    return _TOPIC + name


def dds_type(name: str) -> str:
    """``sensor_msgs/msg/JointState``, or without ``/msg``, is the DDS type ``sensor_msgs::msg::dds_::JointState_``."""
    package, _, own = name.replace("/msg/", "/").partition("/")
    return f"{package}::msg::dds_::{own}_"


def resolved(name: str, namespace: str, node: str) -> str:
    """``/x`` stays as it is, ``x`` is in the namespace, ``~/x`` below the node's name."""
    if name.startswith("/"):
        return name
    return f"{namespace}/{name.replace('~', node, 1)}"


def check_namespace(text: str) -> str:
    """A namespace with its slash in front, "" for none. Raises Ros2Error."""
    namespace = "" if not text.strip("/") else "/" + text.removeprefix("/")
    if not _NAMESPACE.fullmatch(namespace) or "__" in namespace:
        raise Ros2Error(
            f"{text!r} is no namespace: letters, digits and single underscores, parts with a slash between them, "
            "none beginning with a digit, such as left or cell1/left"
        )
    return namespace


def check_prefix(text: str) -> str:
    """What comes before the names of joints and frames. Raises Ros2Error."""
    if not _PREFIX.fullmatch(text):
        raise Ros2Error(f"{text!r} is no prefix of joint names: letters, digits and underscores, such as left_")
    return text
