"""Pictures of a scene on a machine without a screen: colours, depth, and which body each pixel shows.

    with Cameras(robot.controller.world) as cameras:
        picture = cameras.rgb("wrist")

They are drawn in this process when they are asked for, by the system's EGL, which needs no graphics card (Debian:
``apt install libegl1 libgl1-mesa-dri``), or by OSMesa with ``MUJOCO_GL=osmesa``. Each takes some tens of milliseconds:
for virtual and stepped time, not for a robot that has to keep up with the clock.
"""

import os
import sys
from collections.abc import Mapping
from importlib import import_module
from types import MappingProxyType, TracebackType
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from emulator.physics.description import Camera
from emulator.physics.world import PhysicsWorld
from urproto.compat import Self
from urproto.robots.pose import Pose, matrix_to_rotvec

_MOST_GEOMS: Final = 10_000


class CameraError(Exception):
    """There is no such camera, or nothing here that draws."""


class Cameras:
    """The cameras of a world file, and those of a scene file, which have the usual size. Close it after use."""

    def __init__(self, world: object) -> None:
        if not isinstance(world, PhysicsWorld):
            raise CameraError("only a world with physics has cameras: start with --physics")
        self._world, model = world, world.model
        self._settings = {
            model.camera(i).name: world.plan.cameras.get(model.camera(i).name, Camera(pose=(0.0,) * 6))
            for i in range(model.ncam)
        }
        self._covered = world.covered  # what faults cover, too
        width = max((camera.size[0] for camera in self._settings.values()), default=1)
        height = max((camera.size[1] for camera in self._settings.values()), default=1)
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        self._gl = _gl_context(width, height)
        self._gl.make_current()
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        self._scene = mujoco.MjvScene(model, _MOST_GEOMS)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED

    @property
    def names(self) -> list[str]:
        """Of all cameras."""
        return list(self._settings)

    @property
    def bodies(self) -> Mapping[int, str]:
        """The names of what ``segmentation`` shows, by number; what stands in the base frame is 0."""
        model = self._world.model
        return MappingProxyType({i: model.body(i).name for i in range(model.nbody)})

    def cover(self, name: str, *, covered: bool = True) -> None:
        """Let something cover the lens, or nothing any more."""
        self._setting(name)
        (self._covered.add if covered else self._covered.discard)(name)

    def rgb(self, name: str) -> NDArray[np.uint8]:
        """Colours (height, width, 3)."""
        width, height = self._draw(name)
        picture = np.zeros((height, width, 3), np.uint8)
        if name not in self._covered:
            mujoco.mjr_readPixels(picture, None, mujoco.MjrRect(0, 0, width, height), self._context)
        upright: NDArray[np.uint8] = picture[::-1].copy()
        return upright

    def depth(self, name: str) -> NDArray[np.float32]:
        """Distance along the camera's axis (height, width) [m]; 0 with the lens covered."""
        width, height = self._draw(name)
        raw = np.zeros((height, width), np.float32)
        if name in self._covered:
            return raw
        mujoco.mjr_readPixels(None, raw, mujoco.MjrRect(0, 0, width, height), self._context)
        model = self._world.model
        near, far = (float(plane) * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar))
        metres = near * far / (raw.astype(np.float64) * (far - near) + near)  # OpenGL's perspective, near plane at 1
        upright: NDArray[np.float32] = metres[::-1].astype(np.float32)
        return upright

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
                shown[geom.segid + 1] = self._world.model.geom_bodyid[geom.objid]
        found: NDArray[np.int32] = shown[np.minimum(ids, len(shown) - 1)]
        return found

    def intrinsics(self, name: str) -> NDArray[np.float64]:
        """The camera matrix K (3, 3) in pixels, without distortion."""
        width, height = self._setting(name).size
        angle = np.radians(self._world.model.cam_fovy[self._world.model.camera(name).id])
        focal = 0.5 * height / np.tan(0.5 * angle)
        return np.array([[focal, 0.0, 0.5 * width], [0.0, focal, 0.5 * height], [0.0, 0.0, 1.0]])

    def extrinsics(self, name: str) -> Pose:
        """Where the camera's optical frame is in the base frame: z ahead, x to the right, y down."""
        self._setting(name)
        camera = self._world.model.camera(name).id
        turned = self._world.data.cam_xmat[camera].reshape(3, 3) @ np.diag([1.0, -1.0, -1.0])
        x, y, z = self._world.data.cam_xpos[camera].tolist()
        return (x, y, z, *matrix_to_rotvec(turned.ravel().tolist()))

    def close(self) -> None:
        """Give the graphics memory back."""
        self._context.free()
        self._gl.free()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _setting(self, name: str) -> Camera:
        if name not in self._settings:
            raise CameraError(f"there is no camera {name!r}; there are: {', '.join(self._settings) or 'none'}")
        return self._settings[name]

    def _draw(self, name: str) -> tuple[int, int]:
        size = self._setting(name).size
        model, data = self._world.model, self._world.data
        self._gl.make_current()
        mujoco.mj_camlight(model, data)
        self._camera.fixedcamid = model.camera(name).id
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, everything, self._scene)
        mujoco.mjr_render(mujoco.MjrRect(0, 0, *size), self._scene, self._context)
        return size


def _gl_context(width: int, height: int) -> Any:
    if sys.platform == "linux":
        wanted = os.environ.get("MUJOCO_GL", "").lower()
        module = "mujoco.osmesa" if wanted == "osmesa" else "mujoco.egl"
    else:
        module = "mujoco.rendering.classic.gl_context"
    try:
        return import_module(module).GLContext(width, height)
    except Exception as error:  # of PyOpenGL, of many kinds: a library that is not there is an AttributeError
        reason = " ".join(str(error).split())[:200]
        raise CameraError(
            f"nothing here draws pictures ({module}: {reason}): install EGL (Debian: libegl1 libgl1-mesa-dri) or OSMesa"
        ) from error
