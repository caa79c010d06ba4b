"""The controller manager that runs for the pendant's robot: its controllers, and sliders that move the arm."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Final

from client.controllers.remote import RemoteManager
from client.errors import ClientError, ManagerError
from client.pendant.polling import Poller
from urproto.errors import RobotRefused, URError
from urproto.joints import JOINT_NAMES
from urproto.robots import RobotModel
from urproto.vectors import is_number

_PERIOD_S: Final = 1.0  # as often as rqt_joint_trajectory_controller and rqt_controller_manager

Controllers = tuple[dict[str, Any], ...]


class ManagerLink:
    """The connection to the controller manager. Reading ``controllers`` updates it. on_change: called on a change.

    active_panel: the control panel that moves the arm now; only one browser may do so at a time.
    """

    def __init__(self, robot_ip: str, rtde_port: int, on_change: Callable[[], object]) -> None:
        self.active_panel: ControlPanel | None = None
        self._address = robot_ip, rtde_port
        self._manager: RemoteManager | None = None
        self._connecting = asyncio.Lock()
        self._poller = Poller(self._list_controllers, _PERIOD_S, on_change, self.disconnect)

    @property
    def controllers(self) -> Controllers:
        """Loaded controllers, then those that can be loaded, in the state "unloaded"; none without a manager."""
        return self._poller.value or ()

    @property
    def problem(self) -> str:
        """Why the controllers are unknown, "" if they are known."""
        return self._poller.problem

    async def request(self, operation: str, /, **arguments: Any) -> Any:
        """Send a request: see `client.controllers.session.Session`. Raises ClientError."""
        async with self._connecting:
            if self._manager is None:
                self._manager = await RemoteManager(*self._address).__aenter__()
        try:
            return await self._manager.request(operation, **arguments)
        except ManagerError:  # the manager may have ended; the next request opens a new connection
            await self.disconnect()
            raise

    async def change(self, operation: str, /, **arguments: Any) -> None:
        """Send a request that changes controllers, and query them again. Raises ClientError."""
        try:
            await self.request(operation, **arguments)
        finally:
            self._poller.refresh()

    async def disconnect(self) -> None:
        """Close the connection until the next request."""
        manager, self._manager = self._manager, None
        if manager is not None:
            await manager.__aexit__(None, None, None)

    async def close(self) -> None:
        await self._poller.close()
        await self.disconnect()

    async def _list_controllers(self) -> Controllers:
        loaded: list[dict[str, Any]] = await self.request("list_controllers")
        names = {controller["name"] for controller in loaded}
        types: dict[str, str] = await self.request("list_available")
        available = [
            {"name": name, "type": kind, "state": "unloaded"} for name, kind in types.items() if name not in names
        ]
        return (*loaded, *available)


def trajectory_controllers(controllers: Controllers) -> list[str]:
    """Names of the active joint trajectory controllers, which the sliders can use."""
    return sorted(
        controller["name"]
        for controller in controllers
        if controller["state"] == "active" and "JointTrajectoryController" in controller["type"]
    )


class ControlPanel:
    """Six sliders: while enabled, the arm follows them; otherwise they follow the arm.

    As in rqt_joint_trajectory_controller, a trajectory with one point is sent ten times a second. Its duration is what
    the slowest joint takes at its maximum speed times the speed scaling, and at least half a second.

    link: to the manager. read_arm: returns the joint angles (6,) [rad] and the model of the arm, None while they are
    unknown. controller: the controller in use. scaling: 0.01 to 1. on_end: called with the reason when the arm stops
    following, with "" if a user disabled the panel.
    """

    COMMAND_HZ: ClassVar[float] = 10.0
    MIN_DURATION_S: ClassVar[float] = 5.0 / COMMAND_HZ

    def __init__(self, link: ManagerLink, read_arm: Callable[[], tuple[Sequence[float], RobotModel] | None]) -> None:
        self._link = link
        self._read_arm = read_arm
        self._sending: asyncio.Task[None] | None = None
        self.controller = ""
        self.scaling = 0.5
        self.targets: tuple[float, ...] = ()
        self.on_end: list[Callable[[str], object]] = []

    @property
    def enabled(self) -> bool:
        """Whether the arm follows the sliders."""
        return self._sending is not None

    def enable(self) -> None:
        """Let the arm follow the sliders, starting at its present position. Raises RobotRefused."""
        if self.enabled:
            return
        if self.controller not in trajectory_controllers(self._link.controllers):
            raise RobotRefused("the control panel", "no joint trajectory controller is active", "activate one first")
        if self._link.active_panel is not None:
            raise RobotRefused(
                "the control panel", "the sliders of another browser control the arm", "disable it there"
            )
        if (arm := self._read_arm()) is None:
            raise RobotRefused("the control panel", "the joint angles are unknown", "wait until it is connected")
        self.targets = tuple(arm[0])
        self._link.active_panel = self
        self._sending = asyncio.get_running_loop().create_task(self._send())

    def disable(self, reason: str = "") -> None:
        """Let the sliders follow the arm, which still moves to its last target."""
        if self._sending is None:
            return
        if self._sending is not asyncio.current_task():
            self._sending.cancel()
        self._sending = self._link.active_panel = None
        for callback in self.on_end:
            callback(reason)

    def select_controller(self, controller: str) -> None:
        """Use another controller; the panel is disabled at first."""
        if controller != self.controller:
            self.disable()
            self.controller = controller

    def set_targets(self, targets: Any) -> None:
        """Set the slider positions [rad]; None if the browser has disconnected. Raises ValueError if invalid."""
        if targets is None:
            self.disable()
            return
        if not isinstance(targets, list) or len(targets) != len(JOINT_NAMES) or not all(map(is_number, targets)):
            raise ValueError("sliders send six numbers")
        if self.enabled and (arm := self._read_arm()) is not None:
            limits = zip(targets, *arm[1].position_limits, strict=True)
            self.targets = tuple(min(max(float(target), low), high) for target, low, high in limits)

    def duration_s(self, q: Sequence[float], qd_max: Sequence[float]) -> float:
        """Duration of the motion from these angles to those of the sliders, at full speed of the robot."""
        distances = zip(self.targets, q, qd_max, strict=True)
        return (
            max(max(abs(target - angle) / max_speed, self.MIN_DURATION_S) for target, angle, max_speed in distances)
            / self.scaling
        )

    async def _send(self) -> None:
        try:
            while (arm := self._read_arm()) is not None:
                q, model = arm
                names = self._joints()
                point = {"positions": self.targets, "time_from_start_s": self.duration_s(q, model.qd_max)}
                trajectory = {"joint_names": names, "points": [point]}
                await self._link.request("joint_trajectory", controller=self.controller, trajectory=trajectory)
                await asyncio.sleep(1.0 / self.COMMAND_HZ)
            self.disable("the robot has stopped answering")
        except (URError, ClientError) as error:
            self.disable(str(error))

    def _joints(self) -> list[str]:
        """Joint names of the controller, in the order of the sliders; they may have a prefix. Raises ManagerError."""
        matching = [controller for controller in self._link.controllers if controller["name"] == self.controller]
        joints = matching[0].get("joints", []) if matching else []
        names = [next((joint for joint in joints if joint.endswith(name)), "") for name in JOINT_NAMES]
        if not matching or not all(names) or len(joints) != len(names):
            raise ManagerError(f"{self.controller} no longer controls the six joints of this arm")
        return names
