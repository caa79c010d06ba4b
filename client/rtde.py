"""Data exchange with a robot: receive its state at a fixed rate, write its inputs.

    async with RTDEClient("192.168.56.101", ["timestamp", "actual_q"], frequency_hz=125) as rtde:
        state = await rtde.receive()          # {"timestamp": 41.2, "actual_q": (0.0, ...)}

    with BlockingRTDEClient("192.168.56.101", Path("outputs.txt"), [["input_int_register_24"]]) as rtde:
        state = rtde.latest()                 # the newest, however slow the loop is
        rtde.write(input_int_register_24=7)

Variables and their types are those of urproto.rtde.fields. A recipe the robot refuses is a
RobotRefused that names the variables. Options are those of RTDECore.
"""

from collections.abc import Iterable, Iterator
from typing import Any

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Connection, Flow
from client.rtde_core import Names, RTDECore, State

PORT = 30004
_RECONNECT_S = 60.0  # guess: a controller boots in about a minute


class _Recipes(Connection):
    """What both shells agree on with the robot."""

    def __init__(
        self,
        host: str,
        outputs: Names,
        inputs: Iterable[Names] = (),
        *,
        frequency_hz: float | None = None,
        ignore_unavailable: bool = False,
        reconnect_s: float = 0.0,
        port: int = PORT,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        super().__init__(host, port, timeout_s)
        self.core = RTDECore(
            outputs, inputs, frequency_hz, ignore_unavailable=ignore_unavailable, reconnect_s=reconnect_s
        )

    def _opening(self) -> Flow[None]:
        return self.core.start()


class RTDEClient(_Recipes, AsyncConnection):
    """RTDE for asyncio programs. Entering connects, agrees on the recipes and starts.

    One task may receive while others write.
    """

    async def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return await self.run(self.core.receive())

    async def latest(self) -> State:
        """The newest state that has arrived; waits when none came since the last one."""
        return await self.run(self.core.latest())

    async def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        await self.run(self.core.send(values))

    async def write(self, **values: Any) -> None:
        """Write some inputs; the others of their recipes keep their last values, masks are 0."""
        await self.run(self.core.write(values))

    async def pause(self) -> None:
        """Let no more states come until ``resume``."""
        await self.run(self.core.pause())

    async def resume(self) -> None:
        """Let states come again."""
        await self.run(self.core.resume())

    async def reconnect(self, within_s: float = _RECONNECT_S) -> None:
        """Come back after a loss, with the same recipes; paused if it was."""
        await self.run(self.core.reconnect(within_s))


class BlockingRTDEClient(_Recipes, BlockingConnection):
    """RTDE for scripts, notebooks and control loops."""

    def receive(self) -> State:
        """The next state, by variable name; in order, none skipped."""
        return self.run(self.core.receive())

    def latest(self) -> State:
        """The newest state that has arrived; waits when none came since the last one."""
        return self.run(self.core.latest())

    def states(self, silence_s: float) -> Iterator[State]:
        """Every state from now on, with as little work for each as can be: for a thread that does nothing else.

        Raises NoAnswerError when nothing comes for ``silence_s``, ConnectionLostError.
        """
        yield from self.core.take(b"")
        for data in self.chunks(silence_s):
            yield from self.core.take(data)

    def send(self, **values: Any) -> None:
        """Write inputs; the names must be exactly those of one input recipe."""
        self.run(self.core.send(values))

    def write(self, **values: Any) -> None:
        """Write some inputs; the others of their recipes keep their last values, masks are 0."""
        self.run(self.core.write(values))

    def pause(self) -> None:
        """Let no more states come until ``resume``."""
        self.run(self.core.pause())

    def resume(self) -> None:
        """Let states come again."""
        self.run(self.core.resume())

    def reconnect(self, within_s: float = _RECONNECT_S) -> None:
        """Come back after a loss, with the same recipes; paused if it was."""
        self.run(self.core.reconnect(within_s))
