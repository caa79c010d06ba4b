"""Rendering of a scene without a screen: colours, depth, and which body each pixel shows.

    with open_cameras(robot.controller.world) as cameras:
        picture = cameras.rgb("wrist")

Pictures are rendered on request in this process, by the system's EGL, which needs no graphics card (Debian:
``apt install libegl1 libgl1-mesa-dri``), or by OSMesa with ``MUJOCO_GL=osmesa``. Each takes some tens of milliseconds,
most of them with Python's interpreter locked, which is suitable for virtual and stepped time. For a robot in real time,
`emulator.physics.drawing` renders them in a separate process.
"""

import os
import sys
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from importlib import import_module
from types import MappingProxyType
from typing import Any, Final, Protocol, TypeVar

import mujoco
import numpy as np
from numpy.typing import NDArray

from emulator.physics.arm_bodies import FLANGE, PREFIX
from emulator.physics.description import Camera
from urproto.cameras import BASE, MOVING, CameraDescription
from urproto.cameras import FLANGE as ON_FLANGE
from urproto.compat import Self
from urproto.robots.pose import Pose, matrix_to_rotvec

_Pixel = TypeVar("_Pixel", bound=np.generic)

_MAX_GEOMS: Final = 10_000
_TO_OPTICAL: Final = np.diag([1.0, -1.0, -1.0])  # MuJoCo's cameras look along -z with y up


class CameraError(Exception):
    """There is no such camera, or no renderer is available."""


class Scenery(Protocol):
    """The rendered scene: a model and its state, its cameras, and the names of those that are covered."""

    @property
    def model(self) -> Any: ...

    @property
    def data(self) -> Any: ...

    @property
    def cameras(self) -> Mapping[str, Camera]: ...

    @property
    def covered(self) -> AbstractSet[str]: ...


def camera_of(scenery: Scenery, name: str) -> Camera:
    """Settings of a camera. Raises CameraError."""
    if name not in scenery.cameras:
        raise CameraError(f"there is no camera {name!r}; there are: {', '.join(scenery.cameras) or 'none'}")
    return scenery.cameras[name]


def intrinsics(scenery: Scenery, name: str) -> NDArray[np.float64]:
    """The camera matrix K (3, 3) in pixels, without distortion. Raises CameraError."""
    width, height = camera_of(scenery, name).size
    angle = np.radians(scenery.model.cam_fovy[scenery.model.camera(name).id])
    focal = 0.5 * height / np.tan(0.5 * angle)
    return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])


def extrinsics(scenery: Scenery, name: str) -> Pose:
    """Pose of the camera's optical frame in the base frame: z ahead, x to the right, y down. Raises CameraError."""
    camera_of(scenery, name)
    camera = scenery.model.camera(name).id
    return _optical(scenery.data.cam_xpos[camera], scenery.data.cam_xmat[camera].reshape(3, 3))


def describe(scenery: Scenery, name: str) -> CameraDescription:
    """Description of a camera, for receivers of its pictures. Raises CameraError."""
    width, height = camera_of(scenery, name).size
    model = scenery.model
    camera = model.camera(name).id
    body = int(model.cam_bodyid[camera])
    pose, frame = extrinsics(scenery, name), MOVING
    if model.cam_mode[camera] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
        frame = {0: BASE, model.body(PREFIX + FLANGE).id: ON_FLANGE}.get(body, MOVING)
    if frame == ON_FLANGE:
        pose = _optical(model.cam_pos[camera], _matrix(model.cam_quat[camera]))
    matrix = tuple(intrinsics(scenery, name).ravel().tolist())
    return CameraDescription(name, width, height, matrix, frame, pose)


def _optical(place: NDArray[np.float64], turned: NDArray[np.float64]) -> Pose:
    x, y, z = place.tolist()
    return (x, y, z, *matrix_to_rotvec((turned @ _TO_OPTICAL).ravel().tolist()))


def _matrix(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


class Cameras:
    """The cameras of a world file, and those of a scene file, which have the default size. Close it after use."""

    def __init__(self, scenery: Scenery) -> None:
        self._scenery, model = scenery, scenery.model
        width = max((camera.size[0] for camera in scenery.cameras.values()), default=1)
        height = max((camera.size[1] for camera in scenery.cameras.values()), default=1)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        self._gl = _gl_context(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, _MAX_GEOMS)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED

    @property
    def names(self) -> list[str]:
        return list(self._scenery.cameras)

    @property
    def bodies(self) -> Mapping[int, str]:
        """Names of the bodies that ``segmentation`` shows, by number; everything fixed in the base frame is 0."""
        model = self._scenery.model
        return MappingProxyType({i: model.body(i).name for i in range(model.nbody)})

    def rgb(self, name: str) -> NDArray[np.uint8]:
        """Colours (height, width, 3); black if the lens is covered."""
        picture = self._rgb(name)
        self._draw(name, picture, None)
        return _upright(picture)

    def depth(self, name: str) -> NDArray[np.float32]:
        """Distance along the camera's axis (height, width) [m]; 0 if the lens is covered."""
        raw = self._raw(name)
        self._draw(name, None, raw)
        return self._metres(name, raw)

    def rgbd(self, name: str) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Colours and depth, rendered once."""
        picture, raw = self._rgb(name), self._raw(name)
        self._draw(name, picture, raw)
        return _upright(picture), self._metres(name, raw)

    def segmentation(self, name: str) -> NDArray[np.int32]:
        """The number of the body that each pixel shows (height, width); -1 for none."""
        flags = self._scene.flags
        marks = [int(mujoco.mjtRndFlag.mjRND_SEGMENT), int(mujoco.mjtRndFlag.mjRND_IDCOLOR)]
        flags[marks] = True
        try:
            colours = self.rgb(name).astype(np.int64)
        finally:
            flags[marks] = False
        ids = colours[:, :, 0] + 256 * colours[:, :, 1] + 65536 * colours[:, :, 2]
        shown = np.full(self._scene.ngeom + 1, -1, np.int32)
        for geom in self._scene.geoms[: self._scene.ngeom]:
            if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
                shown[geom.segid + 1] = self._scenery.model.geom_bodyid[geom.objid]
        found: NDArray[np.int32] = shown[np.minimum(ids, len(shown) - 1)]
        return found

    def intrinsics(self, name: str) -> NDArray[np.float64]:
        """The camera matrix K (3, 3) in pixels, without distortion."""
        return intrinsics(self._scenery, name)

    def extrinsics(self, name: str) -> Pose:
        """Pose of the camera's optical frame in the base frame: z ahead, x to the right, y down."""
        return extrinsics(self._scenery, name)

    def close(self) -> None:
        self._context.free()
        self._gl.free()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _rgb(self, name: str) -> NDArray[np.uint8]:
        width, height = camera_of(self._scenery, name).size
        return np.zeros((height, width, 3), np.uint8)

    def _raw(self, name: str) -> NDArray[np.float32]:
        width, height = camera_of(self._scenery, name).size
        return np.zeros((height, width), np.float32)

    def _draw(self, name: str, rgb: NDArray[np.uint8] | None, depth: NDArray[np.float32] | None) -> None:
        """Render into the given arrays, bottom row first; nothing is drawn if the lens is covered."""
        model, data = self._scenery.model, self._scenery.data
        self._gl.make_current()
        mujoco.mj_camlight(model, data)
        self._camera.fixedcamid = model.camera(name).id
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        if name in self._scenery.covered:
            return
        area = mujoco.MjrRect(0, 0, *camera_of(self._scenery, name).size)
        mujoco.mjr_render(area, self._scene, self._context)
        mujoco.mjr_readPixels(rgb, depth, area, self._context)

    def _metres(self, name: str, raw: NDArray[np.float32]) -> NDArray[np.float32]:
        if name in self._scenery.covered:
            return raw
        model = self._scenery.model
        near, far = (float(plane) * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar))
        metres = near * far / (raw.astype(np.float64) * (far - near) + near)  # OpenGL's perspective, near plane at 1
        return _upright(metres.astype(np.float32))


def _upright(picture: NDArray[_Pixel]) -> NDArray[_Pixel]:
    """OpenGL has the lowest row first."""
    return np.ascontiguousarray(picture[::-1])


def _gl_context(width: int, height: int) -> Any:
    if sys.platform == "linux":
        wanted = os.environ.get("MUJOCO_GL", "").lower()
        module = "mujoco.osmesa" if wanted == "osmesa" else "mujoco.egl"
    else:
        module = "mujoco.rendering.classic.gl_context"
    try:
        return import_module(module).GLContext(width, height)
    except Exception as error:  # PyOpenGL raises many kinds; a missing library is an AttributeError
        reason = " ".join(str(error).split())[:200]
        raise CameraError(
            f"no renderer is available ({module}: {reason}): install EGL (Debian: libegl1 libgl1-mesa-dri) or OSMesa"
        ) from error
