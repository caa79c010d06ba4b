"""Camera images over HTTP, as from an IP camera: those of the cameras in an emulator's scene (``--physics``).

with CameraClient("127.0.0.1") as client:
    for camera in client.cameras():
        shot = client.shot(camera, "rgbd.npz")
        rgb, metres = shot.arrays["rgb"], shot.arrays["depth"]
"""

from client.cameras.pictures import ALL_CAMERAS, CameraClient, CameraFollower, Shot

__all__ = ["ALL_CAMERAS", "CameraClient", "CameraFollower", "Shot"]
