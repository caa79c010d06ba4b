"""The node ``servo_node``: topics and services of MoveIt Servo, in front of `client.controllers.servo`.

The motion itself is computed in the control loop, in each of its cycles. Here, frames are resolved, and the way ahead
is checked against the planning scene of ``move_group``.

Source of names and types: MoveIt. Servo of Humble has to be started and takes any type of command; that of Jazzy runs
from the beginning, and takes the type that was chosen. Services of both are offered, in each distribution those whose
types it has. Unlike there, all types of commands are taken until one is chosen.
"""

from collections.abc import Callable
from typing import Any, Final

from std_msgs.msg import Int8
from std_srvs.srv import SetBool, Trigger

from client.controllers.servo import (
    ACCELERATION_RAD_S2,
    CommandType,
    Servo,
    ServoMotion,
    ServoParameters,
    ServoStatus,
)
from client.errors import ClientError
from client.planning import CollisionChecker
from client.planning.collisions import free_share
from client.ros2 import parameters
from client.ros2.control_side import SERVO, SERVO_STATUS
from client.ros2.host import LATCHED, HostedNode, NodeHost, RefusalLog, interface, interface_if_any
from client.ros2.move_group.monitor import Monitor
from client.ros2.move_group.scene import SceneState
from client.ros2.transforms import Transforms, pose_in
from urproto.robots.pose import axes_of

NAME: Final = "servo_node"
_GROUP: Final = "moveit_servo."  # prefix of the parameters, as in MoveIt
_DEPTH: Final = 10
_TOPICS: Final = (
    ("~/delta_joint_cmds", "control_msgs/msg/JointJog", CommandType.JOINT_JOG),
    ("~/delta_twist_cmds", "geometry_msgs/msg/TwistStamped", CommandType.TWIST),
    ("~/pose_target_cmds", "geometry_msgs/msg/PoseStamped", CommandType.POSE),
)


class ServoNode(HostedNode):
    """The node; when it is closed, the arm comes to rest as no more commands follow. monitor: knows the scene."""

    def __init__(self, host: NodeHost, monitor: Monitor, transforms: Transforms) -> None:
        super().__init__(host, NAME)
        self._monitor = monitor
        self._transforms = transforms
        self._tool = f"{monitor.arm.prefix}tool0"
        self._parameters = ServoParameters()
        self._chosen: CommandType | None = None
        self._checked_ns = 0
        self._checker: tuple[SceneState, CollisionChecker] | None = None
        node = self.node
        parameters.declare(node, self._parameters, self._configure, owner=NAME, prefix=_GROUP)
        for topic, kind, command in _TOPICS:
            node.create_subscription(interface(kind), topic, self._listener(topic, command), _DEPTH)
        choice = interface_if_any("moveit_msgs/srv/ServoCommandType")
        self._status_type = interface_if_any("moveit_msgs/msg/ServoStatus") or Int8
        self._status = node.create_publisher(self._status_type, "~/status", LATCHED)
        self._paused = choice is None
        if choice is not None:
            node.create_service(choice, "~/switch_command_type", self._on_choice)
            node.create_service(SetBool, "~/pause_servo", self._on_pause)
        for name, paused in (("start", False), ("stop", True), ("pause", True), ("unpause", False)):
            if name != "pause" or choice is None:
                node.create_service(Trigger, f"~/{name}_servo", self._switch(paused))
        host.listen(SERVO_STATUS, self._publish)
        self._publish(ServoStatus.NO_WARNING)
        host.spin(node)

    def close(self) -> None:
        self._host.unlisten(SERVO_STATUS)
        super().close()

    # in the node's thread

    def _configure(self, changed: ServoParameters) -> None:
        self._host.do(Servo.configure, SERVO, changed)
        self._parameters = changed

    def _on_choice(self, request: Any, response: Any) -> Any:
        response.success = request.command_type in set(CommandType)
        if response.success:
            self._chosen = CommandType(request.command_type)
        else:
            kinds = ", ".join(f"{kind.name} ({kind:d})" for kind in CommandType)
            self.node.get_logger().error(f"there is no command type {request.command_type}: choose one of {kinds}")
        return response

    def _on_pause(self, request: Any, response: Any) -> Any:
        self._pause(request.data)
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _switch(self, paused: bool) -> Callable[[Any, Any], Any]:
        def switch(request: Any, response: Any) -> Any:
            self._pause(paused)
            response.success = True
            return response

        return switch

    def _pause(self, paused: bool) -> None:
        self._paused = paused
        if paused:
            self._host.do(Servo.stop, SERVO)

    def _listener(self, topic: str, kind: CommandType) -> Callable[[Any], None]:
        refused = RefusalLog(self.node, topic)
        convert = {CommandType.JOINT_JOG: self._jog, CommandType.TWIST: self._twist, CommandType.POSE: self._pose}[kind]

        def listen(message: Any) -> None:
            try:
                if self._paused:
                    raise ClientError("servoing is paused: call ~/start_servo or ~/unpause_servo")
                if self._chosen not in (None, kind):
                    raise ClientError(f"the command type is {self._chosen}: choose {kind} with ~/switch_command_type")
                method, command = convert(message)
                self._host.do(method, SERVO, command)
                self._look_ahead()
            except ClientError as error:
                refused.add(str(error))
                self._publish(ServoStatus.INVALID)

        return listen

    def _jog(self, message: Any) -> tuple[Any, Any]:
        names, speeds = list(message.joint_names), list(message.velocities)
        if len(message.displacements):
            raise ClientError("displacements are not supported, as in MoveIt: give velocities")
        if len(names) != len(speeds):
            raise ClientError(f"{len(speeds)} velocities for {len(names)} joints")
        return Servo.jog, dict(zip(names, speeds, strict=True))

    def _twist(self, message: Any) -> tuple[Any, Any]:
        frame = message.header.frame_id or self._tool
        axes = axes_of(self._host.wait(self._transforms.poses_in_base({frame}, ClientError))[frame])
        vectors = ((part.x, part.y, part.z) for part in (message.twist.linear, message.twist.angular))
        return Servo.twist, [
            sum(map(float.__mul__, row, vector)) for vector in vectors for row in zip(*axes, strict=True)
        ]

    def _pose(self, message: Any) -> tuple[Any, Any]:
        frame = message.header.frame_id
        return Servo.pose, pose_in(
            self._host.wait(self._transforms.poses_in_base({frame}, ClientError)), message, ClientError
        )

    def _look_ahead(self) -> None:
        """Limit the speed if obstacles are ahead, as far as the arm moves until it has stopped without commands."""
        now_ns = self._host.now_ns()
        if 0 <= now_ns - self._checked_ns < 1e9 / self._parameters.collision_check_rate:
            return
        self._checked_ns = now_ns
        motion: ServoMotion = self._host.do(Servo.motion, SERVO)
        if self._parameters.check_collisions:
            braking_s = max(map(abs, motion.qd_rad_s)) / ACCELERATION_RAD_S2
            ahead_s = self._parameters.incoming_command_timeout + braking_s
            share = free_share(self._current_checker(), motion.q_rad, motion.qd_rad_s, ahead_s)
        else:
            share = 1.0
        self._host.do(Servo.limit, SERVO, share)
        self._publish(motion.status)

    def _current_checker(self) -> CollisionChecker:
        state = self._monitor.state
        if self._checker is None or self._checker[0] is not state:
            self._checker = state, CollisionChecker(state.scene())
        return self._checker[1]

    # anywhere

    def _publish(self, status: ServoStatus) -> None:
        if self._status_type is Int8:
            self._status.publish(Int8(data=int(status)))
        else:
            self._status.publish(self._status_type(code=int(status), message=str(status)))
