"""What an arm is for LeRobot, whether it leads or follows: connected or not, and calibrated by the manufacturer."""

from client.robot import Robot


class ConnectedArm:
    """An arm that is never calibrated or configured from here."""

    _robot: Robot | None = None

    @property
    def is_connected(self) -> bool:
        return self._robot is not None

    @property
    def is_calibrated(self) -> bool:
        return True

    def calibrate(self) -> None: ...

    def configure(self) -> None: ...
