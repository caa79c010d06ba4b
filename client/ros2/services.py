"""Services of controllers, one row each, with the names and types of the ROS 2 driver.

A request to the robot is answered when the robot has executed it. An invalid request, or one that arrives while the
controller is not active, gets ``success`` false and a line in the log.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from rclpy.node import Node

from client.controllers.compliance import ForceModeController
from client.controllers.controller import Controller
from client.controllers.io_and_status import (
    FrictionModelController,
    GPIOController,
    GravityUpdateController,
    URConfigurationController,
)
from client.controllers.joint_trajectory import JointTrajectoryController
from client.driver.availability import offers
from client.ros2.host import NodeHost, RemoteController, interface
from client.ros2.topics import CommandContext, seconds
from client.ros2.transforms import Transforms, pose_in
from urproto.errors import URError
from urproto.robots.pose import Pose, pose_trans
from urproto.versions import PolyscopeVersion

_TRIGGER: Final = "std_srvs/srv/Trigger"


@dataclass(frozen=True)
class ControllerService:
    """A service.

    execute: passes a request to the controller, waits for the robot's answer if there is one, and sets the fields of
    the response besides success and message; raises ControllerError. stamped: the part of a request with a frame, if
    any; execute gets the pose of that frame.
    """

    controller: type[Controller[Any]]
    name: str
    type: str
    execute: Callable[[RemoteController, Any, Any, "ServiceContext"], None]
    stamped: Callable[[Any], Any] | None = None


@dataclass(frozen=True)
class ServiceContext:
    """Context of a request. version: the robot's. frames: poses in the base of the frames that the request names.

    times: converts times of messages.
    """

    version: PolyscopeVersion
    frames: Mapping[str, Pose]
    times: CommandContext


def _set_io(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    if request.fun == request.FUN_SET_DIGITAL_OUT:
        if request.state != request.state:
            raise controller.error(f"the state of digital output {request.pin} is not a number: use 0 (off) or 1 (on)")
        controller.request(GPIOController.set_digital_out, request.pin, request.state != 0.0)
    elif request.fun == request.FUN_SET_ANALOG_OUT:
        controller.request(GPIOController.set_analog_out, request.pin, request.state)
    elif request.fun == request.FUN_SET_TOOL_VOLTAGE:
        controller.request(GPIOController.set_tool_voltage, request.state)
    else:
        raise controller.error(f"function {request.fun} of set_io is not available: use 1, 3 or 4")


def _set_analog_output(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    data = request.data
    if data.domain not in (data.CURRENT, data.VOLTAGE):
        raise controller.error(f"the domain must be 0 (current) or 1 (voltage), not {data.domain}")
    voltage = data.domain == data.VOLTAGE
    controller.request(GPIOController.set_analog_out, data.pin, data.state, voltage=voltage)


def _set_payload(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    """Set mass and centre of gravity, and inertia and transition time if possible.

    Requests have had the latter two since 2025; controllers have accepted them since 5.10.
    """
    cog = request.center_of_gravity
    centre = (cog.x, cog.y, cog.z)
    rest: tuple[Any, ...] = ()
    if hasattr(request, "ixx") and offers("set_target_payload", context.version):
        inertia = (request.ixx, request.iyy, request.izz, request.ixy, request.ixz, request.iyz)
        rest = (inertia, seconds(request.transition_time))
    controller.request(GPIOController.set_payload, request.mass, centre, *rest)


def _set_gravity(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    """Set the gravity. ROS gives the direction in which objects fall; the robot takes the opposite acceleration."""
    frame = context.frames[request.gravity.header.frame_id]
    vector = request.gravity.vector
    turned = pose_trans((0.0, 0.0, 0.0, *frame[3:]), (-vector.x, -vector.y, -vector.z, 0.0, 0.0, 0.0))
    controller.request(GravityUpdateController.set_gravity, turned[:3])


def _set_friction(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    scales = request.parameters
    controller.request(
        FrictionModelController.set_friction_model_parameters, list(scales.viscous_scale), list(scales.coulomb_scale)
    )


def _start_force_mode(controller: RemoteController, request: Any, _: Any, context: ServiceContext) -> None:
    wrench = request.wrench
    axes = ("x", "y", "z", "rx", "ry", "rz")
    limits, deviations = request.speed_limits, request.deviation_limits
    controller.request(
        ForceModeController.start_force_mode,
        pose_in(context.frames, request.task_frame, controller.error),
        [int(getattr(request, f"selection_vector_{axis}")) for axis in axes],
        [wrench.force.x, wrench.force.y, wrench.force.z, wrench.torque.x, wrench.torque.y, wrench.torque.z],
        type=request.type,
        speed_limits=(
            limits.linear.x, limits.linear.y, limits.linear.z, limits.angular.x, limits.angular.y, limits.angular.z,
        ),
        deviation_limits=list(deviations),
        damping_factor=request.damping_factor,
        gain_scaling=request.gain_scaling,
    )  # fmt: skip


def _version(controller: RemoteController, request: Any, response: Any, context: ServiceContext) -> None:
    response.major, response.minor, response.bugfix, response.build = controller.do(
        URConfigurationController.robot_software_version
    )


def _trajectory_state(controller: RemoteController, request: Any, response: Any, context: ServiceContext) -> None:
    point = controller.do(JointTrajectoryController.sampled, context.times.robot_time_s(request.time))
    response.name = list(controller.joints)
    response.position = list(point.positions)
    response.velocity = list(point.velocities)
    response.acceleration = list(point.accelerations)


def _trigger(controller: type[Controller[Any]], method: Callable[..., Any]) -> ControllerService:
    """A service without arguments, named after the method of the controller that it calls."""
    return ControllerService(controller, method.__name__, _TRIGGER, lambda remote, *_: remote.request(method))


SERVICES: Final = (
    ControllerService(GPIOController, "set_io", "ur_msgs/srv/SetIO", _set_io),
    ControllerService(GPIOController, "set_analog_output", "ur_msgs/srv/SetAnalogOutput", _set_analog_output),
    ControllerService(
        GPIOController,
        "set_speed_slider",
        "ur_msgs/srv/SetSpeedSliderFraction",
        lambda controller, request, *_: controller.request(
            GPIOController.set_speed_slider, request.speed_slider_fraction
        ),
    ),
    _trigger(GPIOController, GPIOController.resend_robot_program),
    _trigger(GPIOController, GPIOController.hand_back_control),
    ControllerService(GPIOController, "set_payload", "ur_msgs/srv/SetPayload", _set_payload),
    _trigger(GPIOController, GPIOController.zero_ftsensor),
    ControllerService(
        ForceModeController,
        "start_force_mode",
        "ur_msgs/srv/SetForceMode",
        _start_force_mode,
        lambda request: request.task_frame,
    ),
    _trigger(ForceModeController, ForceModeController.stop_force_mode),
    ControllerService(
        GravityUpdateController, "set_gravity", "ur_msgs/srv/SetGravity", _set_gravity, lambda request: request.gravity
    ),
    ControllerService(
        FrictionModelController,
        "set_friction_model_parameters",
        "ur_msgs/srv/SetFrictionModelParameters",
        _set_friction,
    ),
    ControllerService(
        URConfigurationController, "get_robot_software_version", "ur_msgs/srv/GetRobotSoftwareVersion", _version
    ),
    ControllerService(
        JointTrajectoryController, "query_state", "control_msgs/srv/QueryTrajectoryState", _trajectory_state
    ),
)


def serve(
    host: NodeHost, node: Node, controller: RemoteController, version: PolyscopeVersion, transforms: Transforms
) -> None:
    """Offer a controller's services on its node. version: the robot's."""

    def handler(row: ControllerService) -> Callable[[Any, Any], Any]:
        def handle(request: Any, response: Any) -> Any:
            frames = (row.stamped(request).header.frame_id,) if row.stamped else ()
            reason = ""
            try:
                poses = host.wait(transforms.poses_in_base(frames, controller.error)) if frames else {}
                row.execute(controller, request, response, ServiceContext(version, poses, CommandContext(host)))
            except URError as error:
                reason = str(error)
                node.get_logger().error(f"{row.name}: {reason}")
            if hasattr(response, "success"):
                response.success = not reason
            for text in ("message", "status"):
                if reason and hasattr(response, text):
                    setattr(response, text, reason)
            return response

        return handle

    for row in SERVICES:
        if issubclass(controller.kind, row.controller):
            node.create_service(interface(row.type), f"~/{row.name}", handler(row))
