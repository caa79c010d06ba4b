"""Images from a robot's cameras over HTTP: the URLs, their contents, and the description of a camera.

    GET /cameras                      every camera: JSON, `CameraDescription.as_json` each
    GET /cameras/overview/rgb.mjpeg   a stream of JPEG images (multipart/x-mixed-replace), ?fps=5 limits the rate
    GET /cameras/overview/rgb.jpg     one image, taken after the request arrived

The other formats are numpy's own files (``numpy.load``), and 16-bit PNG.
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
    "depth.png": "image/png",  # 16 bit: the same in mm, 0 for none or more than 65.535 m
    "rgbd.npz": "application/x-npz",  # rgb and depth of the same instant
    "segmentation.npy": "application/x-npy",  # (height, width) int32: number of the body, -1 for none
}
"""The single images of a camera and their content types."""

TIME_HEADER: Final = "x-timestamp"
"""When an image was taken, in the robot's time, like RTDE's ``timestamp`` [s]."""
POSE_HEADER: Final = "x-camera-pose"
"""Pose of the camera's optical frame at that time: x, y, z [m], rx, ry, rz [rad] in the base frame."""

BASE, FLANGE, MOVING = "base", "flange", ""
"""What a camera is attached to: the robot's base frame, its flange, or another moving object."""


@dataclass(frozen=True)
class CameraDescription:
    """The description of a camera. width, height: pixels. matrix: K by rows [pixels]; there is no distortion.

    frame: what it is attached to. pose: of the optical frame (z forward, x to the right, y down) in that frame. If the
    camera is attached to neither base nor flange, it is the pose in the base frame at the time of the request.
    """

    name: str
    width: int
    height: int
    matrix: tuple[float, ...]
    frame: str
    pose: Pose

    def as_json(self) -> dict[str, Any]:
        """The entry in the index, with the URLs of its images."""
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
        """Read an entry of the index. Raises ValueError if it is not a camera."""
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
    """The path of a camera's image. form: one of `FORMS`, or `STREAM`."""
    return f"{CAMERAS}/{quote(name, safe='')}/{form}"


def pose_text(pose: Pose) -> str:
    """A pose as written in the header."""
    return ",".join(f"{value:.6g}" for value in pose)


def pose_of(text: str) -> Pose:
    """Parse the pose in the header. Raises ValueError."""
    return as_six(map(float, text.split(",")))
