"""Joins the topics of ROS 2 with those of controllers.

What controllers tell in a control cycle is sent after it, so that setpoints go out first; nothing is made for topics
that nobody listens to. What arrives is read in the participant's thread and handed over between two cycles; while one
message waits, a newer one replaces it.

with Participant(read_domain()) as participant:
    async with ControlledRobot(host, make_ready=True) as robot, Bridge(robot, participant) as bridge:
        robot.activate(*bridge.broadcasters, "scaled_joint_trajectory_controller")
        participant.start()
"""

import asyncio
import logging
import time
from collections.abc import Callable
from functools import partial
from threading import Lock
from types import TracebackType
from typing import Any, Final, Self

from client.calibration import calibration_of, described
from client.controllers.compliance import FreedriveModeController
from client.controllers.controller import CONTROLLER_TYPES, Controller, LifecycleState, Topic
from client.controllers.goals import JointTrajectory
from client.controllers.joint_trajectory import JointTrajectoryController
from client.controllers.robot import ControlledRobot
from client.driver.robot import cancel
from client.errors import ClientError
from client.recording.definitions import message_type
from client.ros2.dds import Participant, Publisher, resolved
from client.ros2.messages import (
    DESCRIPTION,
    PUBLICATIONS,
    SUBSCRIPTIONS,
    TF_STATIC,
    Moment,
    Publication,
    Scene,
    Subscription,
)
from client.ros2.transforms import Frames
from urproto.robots.description import urdf

_AGAIN_S: Final = 1.0  # as in recordings; guess
_QUIET_S: Final = 1.0  # the same complaint again only after this; guess

_logger = logging.getLogger(__name__)


class Bridge:
    """Gives a controlled robot's controllers their topics; use it with ``async with``, then start the participant.

    All controllers of the robot's file whose types have topics are loaded; broadcasters are those of them that only
    tell. switching: a command for a controller that is not active activates it instead of the one that is, when the
    arm rests; else it is refused. namespace and prefix: as ROS has them, checked. topics: what there is, told or taken.
    """

    def __init__(
        self,
        robot: ControlledRobot,
        participant: Participant,
        *,
        namespace: str = "",
        prefix: str = "",
        switching: bool = True,
    ) -> None:
        self._robot = robot
        self._participant = participant
        self._namespace = namespace
        self._scene = Scene(prefix)
        self._switching = switching
        self._publishers: dict[str, Publisher] = {}
        self._channels: list[_Channel] = []
        self._news: dict[_Channel, Any] = {}
        self._ends: list[Callable[[], None]] = []
        self._loop: asyncio.AbstractEventLoop
        self._again: asyncio.Task[None] | None = None
        self.broadcasters: list[str] = []
        self.topics: list[str] = []

    async def __aenter__(self) -> Self:
        self._loop = asyncio.get_running_loop()
        await self._describe()
        for name in self._load():
            self._connect(self._robot.manager.controller(name))
        self._again = asyncio.create_task(self._tell_again())
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for end in self._ends:
            end()
        if self._again is not None:
            await cancel(self._again)

    async def _describe(self) -> None:
        """Tell the arm's description and fixed frames, if it is known here."""
        link, prefix = self._robot.driver.robot, self._scene.prefix
        calibration = calibration_of(await link.kinematics())
        model = described(link.configuration, calibration) if link.configuration else None
        if model is None:
            _logger.warning("the arm is not a model that is known here: no robot_description, and no frames on /tf")
            return
        frames = Frames(model, prefix)
        self._scene = Scene(prefix, frames)
        self._publisher(TF_STATIC, "tf2_msgs/msg/TFMessage", latched=True).write(frames.fixed(time.time_ns()))
        self._publisher(resolved(DESCRIPTION, self._namespace, ""), "std_msgs/msg/String", latched=True).write(
            {"data": urdf(model, prefix=prefix)}
        )

    def _load(self) -> list[str]:
        """The controllers that have topics, loaded and configured."""
        manager = self._robot.manager
        loaded = {info.name: info.state for info in manager.list_controllers()}
        wanted = tuple(row.controller for row in (*PUBLICATIONS, *SUBSCRIPTIONS))
        names = []
        for name, type_name in manager.file.types.items():
            if not issubclass(CONTROLLER_TYPES.get(type_name, object), wanted):
                continue
            if name not in loaded:
                manager.load(name)
            if loaded.get(name, LifecycleState.UNCONFIGURED) is LifecycleState.UNCONFIGURED:
                manager.configure(name)
            names.append(name)
        return names

    def _connect(self, controller: Controller[Any]) -> None:
        taken = [row for row in SUBSCRIPTIONS if isinstance(controller, row.controller)]
        if not taken:
            self.broadcasters.append(controller.name)
        for publication in PUBLICATIONS:
            if isinstance(controller, publication.controller):
                self._tell(controller, publication)
        for subscription in taken:
            self._take(controller, subscription)

    # what is told

    def _publisher(self, name: str, type_name: str, *, latched: bool = False, depth: int = 1) -> Publisher:
        if name not in self._publishers:
            kind = message_type(type_name)
            self._publishers[name] = self._participant.publisher(name, kind, latched=latched, depth=depth)
            self.topics.append(name)
        return self._publishers[name]

    def _tell(self, controller: Controller[Any], row: Publication) -> None:
        name = resolved(row.name, self._namespace, controller.name)
        publisher = self._publisher(name, row.type, latched=row.latched, depth=row.depth)
        topic: Topic[Any] = getattr(controller, row.source)
        channel = _Channel(publisher, row, topic)
        self._channels.append(channel)
        self._ends.append(topic.subscribe(partial(self._note, channel)))

    def _note(self, channel: "_Channel", message: Any) -> None:
        """Within a control cycle: what is to be sent after it."""
        if not channel.due(self._robot.manager.time_s):
            return
        if not self._news:
            self._loop.call_soon(self._send)
        self._news[channel] = message

    def _send(self) -> None:
        news, self._news = self._news, {}
        time_ns = time.time_ns()
        for channel, message in news.items():
            channel.send(message, time_ns, self._scene)

    async def _tell_again(self) -> None:
        while True:
            await asyncio.sleep(_AGAIN_S)
            for channel in self._channels:
                if channel.row.again and channel.topic.latest is not None:
                    self._note(channel, channel.topic.latest)

    # what is taken

    def _take(self, controller: Controller[Any], row: Subscription) -> None:
        name = resolved(row.name, self._namespace, controller.name)
        inbox = _Inbox(name, controller, row)
        self._participant.subscribe(name, message_type(row.type), partial(self._arrived, inbox))
        self.topics.append(name)

    def _arrived(self, inbox: "_Inbox", values: dict[str, Any]) -> None:
        """In the participant's thread."""
        if inbox.put(values):
            self._loop.call_soon_threadsafe(self._give, inbox)

    def _give(self, inbox: "_Inbox") -> None:
        values = inbox.get()
        if self._again is None or self._again.done():  # the bridge has ended
            return
        now = Moment(self._robot.manager.time_s, time.time_ns())
        try:
            order = inbox.row.order(values, now)
            self._check(inbox, order)
            self._make_active(inbox.controller)
            inbox.row.give(inbox.controller, order)
        except ClientError as error:
            inbox.complain(error)

    def _check(self, inbox: "_Inbox", order: Any) -> None:
        """Before anything is switched for it."""
        if inbox.row.check is not None:
            inbox.row.check(inbox.controller, order)
        if isinstance(order, JointTrajectory):
            self._robot.check_reach(order)

    def _make_active(self, controller: Controller[Any]) -> None:
        if controller.active:
            return
        if not self._switching:
            raise controller.error("it is not active: name it when the bridge is started")
        moving = self._robot.manager.moving()
        for other in moving:
            if _busy(other) or not self._robot.at_rest:
                raise controller.error(f"{other.name} moves the arm: wait until it rests")
        self._robot.manager.switch(activate=[controller.name], deactivate=[other.name for other in moving])
        _logger.info("%s is active now", controller.name)


def _busy(controller: Controller[Any]) -> bool:
    """Whether it is amid something, though the arm may rest at the moment."""
    if isinstance(controller, JointTrajectoryController):
        return controller.progress < 1.0
    return isinstance(controller, FreedriveModeController) and controller.enabled


class _Channel:
    """From a controller's topic to one of ROS 2."""

    def __init__(self, publisher: Publisher, row: Publication, topic: Topic[Any]) -> None:
        self.row = row
        self.topic = topic
        self._publisher = publisher
        self._next_s = 0.0

    def due(self, time_s: float) -> bool:
        """Whether somebody wants to hear it now; a message that is, counts as told."""
        every_s, wait_s = self.row.every_s, self._next_s - time_s
        if not self._publisher.wanted or 0.0 < wait_s <= every_s:
            return False
        in_step = -every_s < wait_s <= 0.0  # else nobody listened for a while, or the robot's clock has jumped
        self._next_s = (self._next_s if in_step else time_s) + every_s
        return True

    def send(self, message: Any, time_ns: int, scene: Scene) -> None:
        """Write it, if there is something to tell."""
        values = self.row.message(message, time_ns, scene)
        if values is not None:
            self._publisher.write(values)


class _Inbox:
    """The newest message for a controller, between the thread that brings it and the loop that hands it over."""

    def __init__(self, name: str, controller: Controller[Any], row: Subscription) -> None:
        self.controller = controller
        self.row = row
        self._name = name
        self._lock = Lock()
        self._values: dict[str, Any] | None = None
        self._complaint = ("", 0.0)

    def put(self, values: dict[str, Any]) -> bool:
        """True when nothing was waiting."""
        with self._lock:
            first, self._values = self._values is None, values
        return first

    def get(self) -> dict[str, Any]:
        """What waits, once after each `put` that was True."""
        with self._lock:
            values, self._values = self._values, None
        assert values is not None
        return values

    def complain(self, error: ClientError) -> None:
        """Tell why a message was refused; the same reason at most once a second."""
        text, now_s = str(error), time.monotonic()
        before, told_s = self._complaint
        if text != before or now_s - told_s >= _QUIET_S:
            self._complaint = (text, now_s)
            _logger.error("%s: a message was refused: %s", self._name, text)
