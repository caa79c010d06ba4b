"""Camera images in ROS 2: names of topics and frames, and the fields of messages as plain values.

Topics and encodings follow Gazebo's and RealSense's cameras: ``/NAME/image_raw`` (rgb8), ``/NAME/camera_info``,
``/NAME/depth/image_raw`` (32FC1, m) and ``/NAME/depth/camera_info``. Compressed images follow image_transport. Frames
follow REP 103: ``NAME_link`` with x forward and z up, and in it ``NAME_optical_frame`` with z forward and y down.
"""

import re
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from client.cameras.pictures import Shot
from urproto.cameras import BASE, FLANGE, CameraDescription
from urproto.robots.pose import Pose, matrix_to_rotvec, pose_inv, pose_trans

IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"

_OPTICAL_IN_LINK: Final[Pose] = (0.0, 0.0, 0.0, *matrix_to_rotvec([0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0]))
_PARENTS: Final = {BASE: "base", FLANGE: "tool0"}  # ur_description's names of the controller's frames
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]")


class FrameTransform(NamedTuple):
    """The pose of a frame in its parent."""

    parent: str
    child: str
    pose: Pose


def ros_name(camera: CameraDescription) -> str:
    """The camera's name as a valid ROS name: other characters become ``_``."""
    name = _NOT_IN_NAMES.sub("_", camera.name)
    return f"_{name}" if name[:1].isdigit() else name or "_"


def optical_frame(camera: CameraDescription, prefix: str = "") -> str:
    """The frame of the camera's messages. prefix: for frames, like tf_prefix."""
    return f"{prefix}{ros_name(camera)}_optical_frame"


def fixed_frames(camera: CameraDescription, prefix: str = "") -> list[FrameTransform]:
    """The camera's frames that never move, for ``/tf_static``."""
    link = f"{prefix}{ros_name(camera)}_link"
    optical = FrameTransform(link, optical_frame(camera, prefix), _OPTICAL_IN_LINK)
    if camera.frame not in _PARENTS:
        return [optical]
    return [FrameTransform(prefix + _PARENTS[camera.frame], link, _link(camera.pose)), optical]


def moving_frames(shot: Shot, prefix: str = "") -> list[FrameTransform]:
    """The camera's moving frames at the time of the image, for ``/tf``."""
    if shot.camera.frame in _PARENTS:
        return []
    return [FrameTransform(f"{prefix}base", f"{prefix}{ros_name(shot.camera)}_link", _link(shot.pose))]


def image(picture: NDArray[Any]) -> dict[str, Any]:
    """A sensor_msgs/Image without header: rgb (height, width, 3) uint8, or depth (height, width) float32 [m]."""
    height, width = picture.shape[:2]
    data = np.ascontiguousarray(picture.astype(picture.dtype.newbyteorder("<"), copy=False)).tobytes()
    return {
        "height": height,
        "width": width,
        "encoding": "rgb8" if picture.ndim == 3 else "32FC1",
        "is_bigendian": 0,
        "step": len(data) // height,
        "data": data,
    }


def compressed(jpeg: bytes) -> dict[str, Any]:
    """A sensor_msgs/CompressedImage without header; its format is the one that image_transport writes."""
    return {"format": "rgb8; jpeg compressed bgr8", "data": jpeg}


def camera_info(camera: CameraDescription) -> dict[str, Any]:
    """A sensor_msgs/CameraInfo without header, of a camera without distortion."""
    k = camera.matrix
    return {
        "height": camera.height,
        "width": camera.width,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": list(k),
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [*k[0:3], 0.0, *k[3:6], 0.0, *k[6:9], 0.0],
    }


def _link(optical: Pose) -> Pose:
    return pose_trans(optical, pose_inv(_OPTICAL_IN_LINK))
