"""The node ``robot_state_publisher``: publishes the arm's description and frames."""

from std_msgs.msg import String

from client.ros2.frames import Frames
from client.ros2.host import LATCHED, NodeHost, RemoteController, interface
from client.ros2.publishing import Outbox, publisher
from client.ros2.topics import MOVING_FRAMES
from urproto.robots import RobotModel
from urproto.robots.description import urdf


class RobotStatePublisher:
    """Publishes a model's description and frames; the node spins from its creation."""

    def __init__(
        self, host: NodeHost, outbox: Outbox, model: RobotModel, states: RemoteController, prefix: str = ""
    ) -> None:
        self._host = host
        self._outbox = outbox
        self.node = host.node("robot_state_publisher")
        description = urdf(model, prefix=prefix)
        self.node.declare_parameter("robot_description", description)
        self.node.declare_parameter("frame_prefix", "")
        self.node.declare_parameter("publish_frequency", 20.0)
        self._description = self.node.create_publisher(String, "robot_description", LATCHED)
        self._description.publish(String(data=description))
        frames = Frames(model, prefix)
        sec, nanosec = divmod(host.now_ns(), 1_000_000_000)
        message = interface("tf2_msgs/msg/TFMessage")(transforms=frames.fixed(sec, nanosec))
        self._static = self.node.create_publisher(type(message), "/tf_static", LATCHED)
        self._static.publish(message)
        outbox.scene.frames = frames
        self._key = outbox.add(states, publisher(self.node, MOVING_FRAMES), MOVING_FRAMES)
        host.spin(self.node)

    def close(self) -> None:
        """End the node."""
        self._outbox.remove(self._key)
        self._host.close(self.node)
