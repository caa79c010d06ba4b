"""The two kinds of arm, by name, for command lines."""

from urproto.compat import StrEnum


class ArmKind(StrEnum):
    """How the arm moves: exactly as its targets, or by torques."""

    IDEAL = "ideal"
    DYNAMIC = "dynamic"
