"""Broadcasters: controllers that command nothing and publish what the hardware reports, once per cycle."""

from dataclasses import dataclass, field
from typing import Final, NamedTuple

from client.controllers.controller import Controller, Interfaces, Topic, controller_type
from client.controllers.parameters import PrefixParameters, without_effect

_KINDS: Final = ("position", "velocity", "effort")
_NO_ROS: Final = "topics have the names that the driver gives them"
_EVERY_CYCLE: Final = "messages come every cycle"
_WRENCH: Final = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
_POSE: Final = (
    "position.x", "position.y", "position.z", "orientation.x", "orientation.y", "orientation.z", "orientation.w",
)  # fmt: skip


class JointState(NamedTuple):
    """State of joints (n,): [rad, rad/s], and effort as the hardware reports it (for UR: motor currents [A])."""

    time_s: float
    name: tuple[str, ...]
    position: tuple[float, ...]
    velocity: tuple[float, ...]
    effort: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class JointStateParameters:
    """joints, interfaces: what to publish; all if empty."""

    joints: tuple[str, ...] = ()
    interfaces: tuple[str, ...] = ()
    extra_joints: tuple[str, ...] = ()
    use_local_topics: bool = without_effect(False, _NO_ROS)
    use_urdf_to_filter: bool = without_effect(True, "there is no URDF")
    frame_id: str = without_effect("base_link", "joint states have no frame")


@controller_type("joint_state_broadcaster/JointStateBroadcaster")
class JointStateBroadcaster(Controller[JointStateParameters]):
    """Publishes positions, velocities and efforts of the joints; extra_joints are added with zeros."""

    def __init__(self, name: str, parameters: JointStateParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.topic: Topic[JointState] = Topic()
        self._joints: tuple[str, ...] = ()
        self._parts: tuple[Interfaces | None, ...] = ()

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        kinds = self.parameters.interfaces or _KINDS
        return tuple(f"{joint}/{kind}" for kind in kinds for joint in self.parameters.joints or ("*_joint",))

    def on_configure(self) -> None:
        if unknown := set(self.parameters.interfaces) - set(_KINDS):
            raise self.error(f"interfaces must be among {', '.join(_KINDS)}, not {min(unknown)}")

    def on_activate(self, time_s: float) -> None:
        self._joints = tuple(dict.fromkeys(name.rpartition("/")[0] for name in self.states.names))
        self._parts = tuple(self._part(kind) for kind in _KINDS)

    def _part(self, kind: str) -> Interfaces | None:
        names = [f"{joint}/{kind}" for joint in self._joints]
        return self.states.lend(names) if all(name in self.states for name in names) else None

    def update(self, time_s: float, period_s: float) -> None:
        extra = (0.0,) * len(self.parameters.extra_joints)
        position, velocity, effort = (tuple(part.get()) + extra if part else () for part in self._parts)
        names = self._joints + self.parameters.extra_joints
        self.topic.publish(JointState(time_s, names, position, velocity, effort))


@dataclass(frozen=True, slots=True)
class SpeedScalingParameters(PrefixParameters):
    state_publish_rate: float = without_effect(100.0, _EVERY_CYCLE)


@controller_type("ur_controllers/SpeedScalingStateBroadcaster")
class SpeedScalingStateBroadcaster(Controller[SpeedScalingParameters]):
    """Publishes the speed scaling in percent: 100 is full speed, 0 is a waiting robot."""

    def __init__(self, name: str, parameters: SpeedScalingParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.topic: Topic[float] = Topic()

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        return (f"{self.parameters.tf_prefix}speed_scaling/speed_scaling_factor",)

    def update(self, time_s: float, period_s: float) -> None:
        self.topic.publish(100.0 * self.states.get()[0])


class WrenchStamped(NamedTuple):
    """Force [N] (3,) and torque [Nm] (3,) in the frame ``frame_id``."""

    time_s: float
    frame_id: str
    force: tuple[float, ...]
    torque: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Axes:
    """A name for each axis."""

    x: str = ""
    y: str = ""
    z: str = ""


@dataclass(frozen=True, slots=True)
class AxisOffsets:
    """Offsets added to the measured values along or about each axis [N or Nm]."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class AxisFactors:
    """Factors for the measured values along or about each axis."""

    x: float = 1.0
    y: float = 1.0
    z: float = 1.0


@dataclass(frozen=True, slots=True)
class WrenchNames:
    """Names of state interfaces that do not belong to a sensor."""

    force: Axes = field(default_factory=Axes)
    torque: Axes = field(default_factory=Axes)


@dataclass(frozen=True, slots=True)
class WrenchOffsets:
    """Offsets of force and torque; axes that are left out have none."""

    force: AxisOffsets = field(default_factory=AxisOffsets)
    torque: AxisOffsets = field(default_factory=AxisOffsets)


@dataclass(frozen=True, slots=True)
class WrenchFactors:
    """Factors of force and torque; axes that are left out are published as measured."""

    force: AxisFactors = field(default_factory=AxisFactors)
    torque: AxisFactors = field(default_factory=AxisFactors)


@dataclass(frozen=True, slots=True)
class ForceTorqueParameters:
    """Either sensor_name or all six interface_names; offsets are added before the multipliers."""

    sensor_name: str = ""
    frame_id: str = ""
    interface_names: WrenchNames = field(default_factory=WrenchNames)
    offset: WrenchOffsets = field(default_factory=WrenchOffsets)
    multiplier: WrenchFactors = field(default_factory=WrenchFactors)
    state_interface_names: tuple[str, ...] = without_effect(
        (), "the six follow from the sensor's name", unless=(_WRENCH,)
    )
    topic_name: str = without_effect("", _NO_ROS, unless=("ft_data",))  # as in the official file; no effect there, too


@controller_type("force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster")
class ForceTorqueSensorBroadcaster(Controller[ForceTorqueParameters]):
    """Publishes the wrench that the sensor at the tool measures."""

    def __init__(self, name: str, parameters: ForceTorqueParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.topic: Topic[WrenchStamped] = Topic()
        self._offsets = _six(parameters.offset)
        self._multipliers = _six(parameters.multiplier)

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        if sensor := self.parameters.sensor_name:
            return tuple(f"{sensor}/{part}" for part in _WRENCH)
        names = self.parameters.interface_names
        return (names.force.x, names.force.y, names.force.z, names.torque.x, names.torque.y, names.torque.z)

    def on_configure(self) -> None:
        if not all(self.state_interfaces):
            raise self.error("give a sensor_name, or all six interface_names")

    def update(self, time_s: float, period_s: float) -> None:
        values = [
            (value + offset) * multiplier
            for value, offset, multiplier in zip(self.states.get(), self._offsets, self._multipliers, strict=True)
        ]
        self.topic.publish(WrenchStamped(time_s, self.parameters.frame_id, tuple(values[:3]), tuple(values[3:])))


def _six(numbers: WrenchOffsets | WrenchFactors) -> tuple[float, ...]:
    force, torque = numbers.force, numbers.torque
    return (force.x, force.y, force.z, torque.x, torque.y, torque.z)


class PoseStamped(NamedTuple):
    """Position [m] (3,) and orientation as a quaternion x, y, z, w (4,) of ``child_frame_id`` in ``frame_id``."""

    time_s: float
    frame_id: str
    child_frame_id: str
    position: tuple[float, ...]
    orientation: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Transform:
    """The transform on /tf, for ROS. child_frame_id: name of the frame; "" is that of the pose."""

    enable: bool = without_effect(True, "the transform is published always")
    child_frame_id: str = ""
    publish_rate: float = without_effect(0.0, "the transform is published every cycle")


@dataclass(frozen=True, slots=True)
class PoseParameters:
    """pose_name: component name of the state interfaces."""

    frame_id: str
    pose_name: str
    tf: Transform = field(default_factory=Transform)


@controller_type("pose_broadcaster/PoseBroadcaster")
class PoseBroadcaster(Controller[PoseParameters]):
    """Publishes the pose of the tool."""

    def __init__(self, name: str, parameters: PoseParameters, update_rate_hz: float) -> None:
        super().__init__(name, parameters, update_rate_hz)
        self.topic: Topic[PoseStamped] = Topic()

    @property
    def state_interfaces(self) -> tuple[str, ...]:
        return tuple(f"{self.parameters.pose_name}/{part}" for part in _POSE)

    def update(self, time_s: float, period_s: float) -> None:
        values = tuple(self.states.get())
        child = self.parameters.tf.child_frame_id or self.parameters.pose_name
        self.topic.publish(PoseStamped(time_s, self.parameters.frame_id, child, values[:3], values[3:]))
