"""The camera server and the gripper of the vision cell, as far as the robot notices them."""


class Camera:
    """Reports one part after the other; a part that the robot has not taken is found again."""

    def __init__(self) -> None:
        self.parts = [(0.02, -0.03, 0.5), (-0.04, 0.05, -0.2)]

    def __call__(self, message: bytes) -> str | None:
        if message != b"asking_for_part":
            return None
        found = self.parts.pop(0) if self.parts else None
        return "(1, {}, {}, {})".format(*found) if found else "(0, 0, 0, 0)"


class Gripper:
    """A gripper whose fingers need three queries to arrive, and stop at a part of 25 mm."""

    def __init__(self) -> None:
        self.width, self.busy = 100.0, 0

    def rg_grip(self, tool: int, width: float, force: float) -> bool:
        self.width, self.busy = max(float(width), 25.0), 3
        return True

    def rg_get_busy(self, tool: int) -> bool:
        self.busy -= 1
        return self.busy > 0

    def rg_get_width(self, tool: int) -> float:
        return self.width
