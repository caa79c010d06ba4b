"""The two kinds of arm, by name: what a command line needs to know of them."""

from urproto.compat import StrEnum


class ArmKind(StrEnum):
    """What moves the arm: its targets, exactly, or torques."""

    IDEAL = "ideal"
    DYNAMIC = "dynamic"
