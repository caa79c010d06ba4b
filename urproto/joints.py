"""Names of the joints, base to wrist 3."""

from typing import Final

JOINT_NAMES: Final = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""As in ur_description."""

JOINT_TITLES: Final = ("Base", "Shoulder", "Elbow", "Wrist 1", "Wrist 2", "Wrist 3")
"""As shown on PolyScope's screens."""

JOINT_LABELS: Final = (*(title.lower() for title in JOINT_TITLES),)
"""The same within a sentence, as in logs and errors."""
