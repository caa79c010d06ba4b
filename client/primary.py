"""Scripts to a robot, and what it says about them, through the primary interface.

with BlockingPrimaryClient("192.168.56.101") as robot:
    name = robot.run(robot.core.run_script("def hello():\\n  textmsg(1)\\nend"))
"""

from collections import deque

from client.connection import DEFAULT_TIMEOUT_S, AsyncConnection, BlockingConnection, Flow
from client.errors import ScriptFailedError
from urproto.primary.framing import PrimaryDecoder, PrimaryMessage
from urproto.primary.messages import PROGRAM_STARTED, PROGRAM_STOPPED, KeyMessage, RuntimeExceptionMessage

__all__ = ["PORT", "BlockingPrimaryClient", "PrimaryClient", "PrimaryCore"]

PORT = 30001


class PrimaryCore:
    """One client's side of a primary connection, without I/O."""

    def __init__(self) -> None:
        self._decoder = PrimaryDecoder()
        self._received: deque[PrimaryMessage] = deque()

    def next_message(self) -> Flow[PrimaryMessage]:
        """The next message of any type."""
        while not self._received:
            self._received.extend(self._decoder.feed((yield None)))
        return self._received.popleft()

    def send_script(self, text: str) -> Flow[None]:
        """Send a script and wait for nothing: right for ``sec`` programs and bare statements."""
        yield text.encode("utf-8", "replace") + b"\n"

    def run_script(self, text: str) -> Flow[str]:
        """Send a ``def`` program and wait until it runs; its name.

        Raises ScriptFailedError when the controller reports an error in it.
        """
        yield from self.next_message()  # a controller speaks first: this connection is being served
        yield from self.send_script(text)
        return (yield from self._key_message(PROGRAM_STARTED))

    def wait_until_stopped(self) -> Flow[str]:
        """Wait until a program ends; its name. Raises ScriptFailedError when an error ended it."""
        return (yield from self._key_message(PROGRAM_STOPPED))

    def _key_message(self, title: str) -> Flow[str]:
        while True:
            message = yield from self.next_message()
            if isinstance(message, RuntimeExceptionMessage):
                raise ScriptFailedError(message.line, message.column, message.text)
            if isinstance(message, KeyMessage) and message.title == title:
                return message.text


class PrimaryClient(AsyncConnection):
    """The primary interface, for asyncio programs."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = PrimaryCore()


class BlockingPrimaryClient(BlockingConnection):
    """The primary interface, for scripts and notebooks."""

    def __init__(self, host: str, port: int = PORT, timeout_s: float = DEFAULT_TIMEOUT_S) -> None:
        super().__init__(host, port, timeout_s)
        self.core = PrimaryCore()
