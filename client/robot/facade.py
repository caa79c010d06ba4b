"""The two shells of the facade."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager, contextmanager
from functools import partial, update_wrapper
from typing import Any, Concatenate, ParamSpec

from client.driver.blocking import Blocking, blocking, blocking_context
from client.driver.realtime import real_time
from client.driver.reverse import StreamStatistics
from client.robot.contexts import Contexts, Follow
from client.robot.moves import Moves
from client.robot.settings import Settings
from client.robot.state import RobotState
from urproto.robots import Joints
from urproto.robots.pose import Pose

__all__ = ["AsyncRobot", "Robot"]


class AsyncRobot(Moves, Contexts, Settings):
    """A robot for asyncio programs; use it with ``async with``. Options are those of `client.driver.DriverConfig`.

    The driver's ports are any free ones unless they are given, as a firewall may demand.
    """


Given = ParamSpec("Given")


def _streaming(
    method: Callable[Concatenate[AsyncRobot, Given], AbstractAsyncContextManager[Follow]],
) -> Callable[Concatenate[Any, Given], AbstractContextManager[Callable[[Sequence[float]], RobotState]]]:
    """The blocking form of a stream of setpoints: the caller's thread sends them itself, with real-time priority."""

    @contextmanager
    def enter(
        self: Blocking[AsyncRobot], /, *args: Given.args, **kwargs: Given.kwargs
    ) -> Iterator[Callable[[Sequence[float]], RobotState]]:
        context = method(self.inner, *args, **kwargs)
        follow = self.call(context.__aenter__())
        try:
            with real_time(self.inner.driver.config.realtime):
                yield partial(follow.from_thread, self.call)
        except BaseException as error:
            if not self.call(context.__aexit__(type(error), error, error.__traceback__)):
                raise
        else:
            self.call(context.__aexit__(None, None, None))

    update_wrapper(enter, method)
    enter.__dict__.pop("__wrapped__", None)  # it is no coroutine function
    return enter


class Robot(Blocking[AsyncRobot]):
    """The same for scripts and notebooks; use it with ``with``.

    `stop` may be called from another thread. A KeyboardInterrupt during a move stops the arm.
    """

    def __init__(self, host: str, **options: Any) -> None:
        super().__init__(lambda: AsyncRobot(host, **options))

    make_ready = blocking(AsyncRobot.make_ready)
    recover = blocking(AsyncRobot.recover)
    stop = blocking(AsyncRobot.stop)
    wait_done = blocking(AsyncRobot.wait_done)
    wait_for = blocking(AsyncRobot.wait_for)

    move_j = blocking(AsyncRobot.move_j)
    move_l = blocking(AsyncRobot.move_l)
    move_p = blocking(AsyncRobot.move_p)
    move_c = blocking(AsyncRobot.move_c)
    sequence = blocking(AsyncRobot.sequence)
    speed_j = blocking(AsyncRobot.speed_j)
    speed_l = blocking(AsyncRobot.speed_l)

    servo_j = _streaming(AsyncRobot.servo_j)
    servo_pose = _streaming(AsyncRobot.servo_pose)
    velocity_j = _streaming(AsyncRobot.velocity_j)
    velocity_l = _streaming(AsyncRobot.velocity_l)
    freedrive = blocking_context(AsyncRobot.freedrive)
    force_mode = blocking_context(AsyncRobot.force_mode)

    digital_in = blocking(AsyncRobot.digital_in)
    digital_out = blocking(AsyncRobot.digital_out)
    set_digital_out = blocking(AsyncRobot.set_digital_out)
    set_payload = blocking(AsyncRobot.set_payload)
    set_tcp = blocking(AsyncRobot.set_tcp)
    set_speed_slider = blocking(AsyncRobot.set_speed_slider)

    @property
    def state(self) -> RobotState:
        """The newest state."""
        return self.inner.state

    @property
    def q(self) -> Joints:
        """Joint angles (6,) [rad], base to wrist 3."""
        return self.inner.q

    @property
    def tcp_pose(self) -> Pose:
        """TCP in the base frame (6,) [m, rotation vector]."""
        return self.inner.tcp_pose

    def tcp_pose_at(self, q_rad: Sequence[float]) -> Pose:
        """Where the TCP would be (6,) with these joint angles (6,), by the geometry that this very arm reports.

        Raises RobotRefused while the robot has not told its geometry, or for one that is not known here.
        """
        return self.inner.tcp_pose_at(q_rad)

    @property
    def stream(self) -> StreamStatistics:
        """How the setpoints of the present or the last such block went out: sent, skipped, late, longest gap."""
        return self.inner.stream

    @property
    def moving(self) -> bool:
        """True while a motion that was begun here is under way."""
        return self.inner.moving
