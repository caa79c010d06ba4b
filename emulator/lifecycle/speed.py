"""Speed slider and speed scaling."""

import math

from emulator.snapshot import Snapshot

__all__ = ["Speed"]


class Speed:
    """``slider`` is what clients set and read (target_speed_fraction), ``scaling`` what the
    limiter leaves of it (speed_scaling). The motion follows their product smoothly."""

    def __init__(self) -> None:
        self.slider = 1.0
        self.scaling = 1.0

    @property
    def fraction(self) -> float:
        """Fraction of full speed to move at."""
        return self.slider * self.scaling

    def set_slider(self, fraction: float) -> None:
        """Move the slider, clipped to 0..1; no number changes nothing."""
        if not math.isnan(fraction):
            self.slider = min(max(float(fraction), 0.0), 1.0)

    def publish(self, snapshot: Snapshot, path_share: float) -> None:
        """Write slider and scaling to a snapshot that knows the program's state. ``path_share``: of the speed wanted,
        what the joints' limits leave."""
        snapshot.target_speed_fraction = self.slider
        # captures of controllers show 0 while no program plays, and 1 while one plays undisturbed
        snapshot.speed_scaling = self.scaling * path_share if snapshot.program_running else 0.0
