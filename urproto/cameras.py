"""Pictures of a robot's cameras over HTTP: the addresses, what each gives, and how a camera is described.

    GET /cameras                      every camera: JSON, `CameraDescription.as_json` each
    GET /cameras/overview/rgb.mjpeg   a stream of JPEG pictures (multipart/x-mixed-replace), ?fps=5 for fewer
    GET /cameras/overview/rgb.jpg     one picture, taken after the request came

The forms that are not for people's eyes are numpy's own files (``numpy.load``), and 16 bit PNG.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

from urproto.robots.pose import Pose
from urproto.vectors import as_six

CAMERAS: Final = "/cameras"
STREAM: Final = "rgb.mjpeg"
FORMS: Final[Mapping[str, str]] = {
    "rgb.jpg": "image/jpeg",
    "rgb.npy": "application/x-npy",  # (height, width, 3) uint8
    "depth.npy": "application/x-npy",  # (height, width) float32: distance along the optical axis [m], 0 for none
    "depth.png": "image/png",  # 16 bit: that in mm, 0 for none or more than 65.535 m
    "rgbd.npz": "application/x-npz",  # rgb and depth of one moment
    "segmentation.npy": "application/x-npy",  # (height, width) int32: number of the body, -1 for none
}
"""The single pictures of a camera and their content types."""

TIME_HEADER: Final = "x-timestamp"
"""When a picture was taken: the robot's time, as RTDE's ``timestamp`` [s]."""
POSE_HEADER: Final = "x-camera-pose"
"""Where the camera's optical frame was then: x, y, z [m], rx, ry, rz [rad] in the base frame."""

BASE, FLANGE, MOVING = "base", "flange", ""
"""What a camera is fixed to: the robot's base frame, its flange, or something else that moves."""


@dataclass(frozen=True)
class CameraDescription:
    """width, height: pixels. matrix: K by rows, pixels; there is no distortion. frame: what it is fixed to.

    pose: of the optical frame (z ahead, x to the right, y down) in that frame; of one that is fixed to neither, in the
    base frame when it was asked for.
    """

    name: str
    width: int
    height: int
    matrix: tuple[float, ...]
    frame: str
    pose: Pose

    def as_json(self) -> dict[str, Any]:
        """For the index; with the addresses of its pictures."""
        return {
            "name": self.name,
            "width": self.width,
            "height": self.height,
            "matrix": list(self.matrix),
            "frame": self.frame,
            "pose": list(self.pose),
            "pictures": [picture_path(self.name, form) for form in (STREAM, *FORMS)],
        }

    @classmethod
    def from_json(cls, given: Any) -> "CameraDescription":
        """Of the index. Raises ValueError for what is not a camera."""
        try:
            matrix = tuple(float(value) for value in given["matrix"])
            pose = as_six(given["pose"])
            width, height = int(given["width"]), int(given["height"])
            name, frame = str(given["name"]), str(given["frame"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"not a camera: {error}") from error
        if len(matrix) != 9 or not (width > 0 and height > 0):
            raise ValueError(f"not a camera: {name} is {width} x {height} with a matrix of {len(matrix)} numbers")
        return cls(name, width, height, matrix, frame, pose)


def picture_path(name: str, form: str) -> str:
    """Where a camera's picture is. form: one of `FORMS`, or `STREAM`."""
    return f"{CAMERAS}/{quote(name, safe='')}/{form}"


def pose_text(pose: Pose) -> str:
    """A pose as the header has it."""
    return ",".join(f"{value:.6g}" for value in pose)


def pose_of(text: str) -> Pose:
    """That of the header. Raises ValueError."""
    return as_six(map(float, text.split(",")))
