"""Pictures before a plain rclpy program in another process."""

import asyncio
import os

import numpy as np
import pytest
from ros2_rig import free_domain, peer

from client.cameras import CameraClient
from client.ros2.cameras import CameraNode
from client.ros2.host import NodeHost
from tests.served_cameras import DEPTH, JPEG, MATRIX, RGB, served_cameras

pytestmark = pytest.mark.xdist_group("ros2")

IMAGE, INFO, FRAMES = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"


@pytest.mark.long
async def test_subscribers_get_images_of_one_moment_and_unsubscribed_cameras_are_not_requested() -> None:
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    with served_cameras() as served, free_domain() as domain:
        async with NodeHost(domain=domain) as host, peer(domain) as other:
            client = CameraClient(port=served.port)
            cameras = client.chosen(["all"])
            node = await asyncio.to_thread(CameraNode, host, client, cameras, 20.0, "left_")
            try:
                static = await other.echo("/tf_static", FRAMES, latched=True)
                assert served.requested == ["/cameras"]
                rgb = await other.echo("/over_all/image_raw", IMAGE)
                assert (rgb["encoding"], rgb["height"], rgb["width"], rgb["step"]) == ("rgb8", 6, 8, 24)
                assert rgb["data"] == RGB.ravel().tolist()
                assert rgb["header"]["frame_id"] == "left_over_all_optical_frame"
                info = await other.echo("/over_all/camera_info", INFO)
                assert info["k"] == pytest.approx(MATRIX)
                depth = await other.echo("/over_all/depth/image_raw", IMAGE, new=True)
                assert depth["encoding"] == "32FC1"
                assert np.array_equal(np.frombuffer(bytes(depth["data"]), "<f4").reshape(6, 8), DEPTH)
                compressed = await other.echo("/wrist/image_raw/compressed", "sensor_msgs/msg/CompressedImage")
                assert bytes(compressed["data"]) == JPEG
                requested = served.requested[:]
            finally:
                await asyncio.to_thread(node.close)
    assert "/cameras/over%20all/rgbd.npz" in requested, "colours and depth are drawn together"
    assert not [path for path in requested if "belt" in path]
    children = [(t["header"]["frame_id"], t["child_frame_id"]) for t in static["transforms"]]
    assert children == [
        ("left_base", "left_over_all_link"),
        ("left_over_all_link", "left_over_all_optical_frame"),
        ("left_tool0", "left_wrist_link"),
        ("left_wrist_link", "left_wrist_optical_frame"),
        ("left_belt_link", "left_belt_optical_frame"),
    ]
