"""The process of the control loop: how the driver starts it, and what it does.

It is a separate process because the threads of the nodes would delay setpoints: they all share one interpreter lock.
"""

import asyncio
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from contextlib import aclosing, contextmanager, suppress
from typing import Final

from client.ros2.control_side import ControlSide
from urproto.compat import module_command

_ENDS_S: Final = 10.0  # guess: a ramp to rest and the end of a recording take less


@contextmanager
def control_process() -> Iterator[socket.socket]:
    """Run the process; yields the connection, whose end is also the end of the process, and waits for it."""
    link, its_link = socket.socketpair()
    with its_link:
        process = subprocess.Popen(
            module_command(__name__),
            stdin=its_link.fileno(),
            start_new_session=True,  # Ctrl-C is for the nodes, which then end the connection
        )
    try:
        yield link
    finally:
        link.close()
        try:
            process.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


async def work(link: socket.socket) -> None:
    """Execute calls until the nodes have gone, or SIGTERM comes; then the arm is brought to rest."""
    async with aclosing(ControlSide()) as side:
        serving = asyncio.ensure_future(side.calls.serve(link))
        with suppress(NotImplementedError):  # on Windows
            asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, serving.cancel)
        with suppress(asyncio.CancelledError):
            await serving


if __name__ == "__main__":
    asyncio.run(work(socket.socket(fileno=os.dup(0))))  # standard input stays open, and the connection, until the end
