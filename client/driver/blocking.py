"""`BlockingURDriver`: the driver for scripts, notebooks and control loops.

with BlockingURDriver("192.168.56.101") as driver:
    driver.start_program()
    while driver.next_state()["timestamp"] < end:
        driver.servoj(target())
"""

from client.blocking import Blocking
from client.driver.driver import URDriver
from client.rtde import ReceivedState


class BlockingURDriver(Blocking[URDriver]):
    """Blocking form of `URDriver`: its connections run in a separate thread, which also calls the callbacks."""

    def next_state(self) -> ReceivedState:
        """The RTDE state after the newest one."""
        feed = self.inner.link.feed
        return feed.wait(feed.count, self.inner.config.silence_s)
