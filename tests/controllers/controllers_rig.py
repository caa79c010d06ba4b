"""Joints that do what they are told, and a clock that is moved by hand."""

from client.controllers.configuration import ControllersFile
from client.controllers.controller import Interfaces
from client.controllers.goals import JointTrajectory, JointTrajectoryPoint
from client.controllers.manager import ControllerManager
from client.errors import ControllerError

JOINTS = ("shoulder_joint", "elbow_joint")
SCALING = "speed_scaling/speed_scaling_factor"
RATE_HZ = 100.0


class Joints:
    """Hardware that is where it was sent one cycle before; stuck joints stay where they are."""

    def __init__(self, names=JOINTS):
        self.names = names
        moved = [f"{joint}/{kind}" for kind in ("position", "velocity") for joint in names]
        self.states = Interfaces([*moved, SCALING])
        self.commands = Interfaces([*moved, "io/lamp"])
        self.states.fill(0.0)
        self.states[SCALING] = 1.0
        self.failure = None
        self.halt = None
        self.stuck = set()
        self.switches = []
        self.refuses = None
        self.period_s = 0.0

    def read(self, state, period_s):
        for joint in self.names:
            place, speed = f"{joint}/position", f"{joint}/velocity"
            before, wanted, rate = self.states[place], self.commands[place], self.commands[speed]
            if joint in self.stuck:
                continue
            if wanted == wanted:
                self.states[place] = wanted
                self.states[speed] = (wanted - before) / period_s if period_s else 0.0
            elif rate == rate:
                self.states[place], self.states[speed] = before + rate * period_s, rate

    def prepare_command_mode_switch(self, start, stop):
        if self.refuses:
            raise ControllerError("hardware", self.refuses)

    def perform_command_mode_switch(self, start, stop):
        self.switches.append((tuple(start), tuple(stop)))
        self.commands.lend(list(stop)).fill(float("nan"))

    def write(self, time_s, period_s):
        pass

    def take_halt(self):
        halt, self.halt = self.halt, None
        return halt


class Bench:
    """A manager over such joints."""

    def __init__(self, file=None, **parameters):
        self.joints = Joints()
        self.manager = ControllerManager(self.joints, file or one_controller(**parameters), RATE_HZ)
        self.time_s = 10.0
        self.cycle()

    def cycle(self, count=1):
        for _ in range(count):
            self.time_s = round(self.time_s + 1.0 / RATE_HZ, 9)
            self.manager.cycle({}, self.time_s, 1.0 / RATE_HZ)

    def run(self, seconds):
        self.cycle(round(seconds * RATE_HZ))

    def until(self, handle, seconds=60.0):
        for _ in range(round(seconds * RATE_HZ)):
            if handle.done:
                return handle.result
            self.cycle()
        raise AssertionError(f"no result within {seconds} s")

    @property
    def q(self):
        return tuple(self.joints.states[f"{joint}/position"] for joint in JOINTS)


def one_controller(**parameters):
    """A file with the joint trajectory controller ``jtc`` and the scaled one ``scaled``."""
    common = {"joints": list(JOINTS), "command_interfaces": ["position"], "state_interfaces": ["position", "velocity"]}
    return ControllersFile(
        "test",
        {
            "jtc": "joint_trajectory_controller/JointTrajectoryController",
            "scaled": "ur_controllers/ScaledJointTrajectoryController",
            "forward": "forward_command_controller/ForwardCommandController",
            "speeds": "velocity_controllers/JointGroupVelocityController",
            "states": "joint_state_broadcaster/JointStateBroadcaster",
        },
        {
            "jtc": common | parameters,
            "scaled": common | parameters,
            "forward": {"joints": list(JOINTS), "interface_name": "position"},
            "speeds": {"joints": list(JOINTS)},
        },
    )


def started(name="jtc", **parameters):
    """A bench and its active controller."""
    bench = Bench(**parameters)
    bench.manager.activate(name)
    bench.cycle()
    return bench, bench.manager.controller(name)


def point(time_s, *positions, v=(), a=()):
    return JointTrajectoryPoint(tuple(map(float, positions)), tuple(v), tuple(a), time_from_start_s=time_s)


def trajectory(*points, names=JOINTS, stamp_s=0.0):
    return JointTrajectory(tuple(names), points, stamp_s)
