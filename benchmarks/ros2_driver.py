"""What the ROS 2 driver costs beside controllers without ROS, at an arm of 500 Hz.

Both are processes of their own before an emulated UR5e, with the scaled trajectory controller and the joint state
broadcaster active; the subscriber is a third one, whose cost does not count.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

from pendant import cpu_s
from table import Table

SECONDS: Final = 10.0
HOST: Final = "127.0.0.79"
_DOMAIN: Final = "79"
_SETTLED_S: Final = 5.0  # after the start
_CONTROLLERS: Final = ("joint_state_broadcaster", "scaled_joint_trajectory_controller")


def measure(seconds: float = SECONDS) -> Table:
    """One row for the controllers alone, the driver, and the driver with a subscriber."""
    rows = [
        _row("`ur-client controllers load`", ["controllers", "load", *_CONTROLLERS], seconds, subscribed=False),
        _row("`ur-client ros2`", ["ros2"], seconds, subscribed=False),
        _row("`ur-client ros2`, `/joint_states` heard", ["ros2"], seconds, subscribed=True),
    ]
    about = (
        f"Controllers of an emulated UR5e at 500 Hz, at rest, for {seconds:g} s. Cost: processor time of a process in "
        "shares of a core. Bar: what ROS adds stays below a tenth."
    )
    return Table("ROS 2 driver", about, ["process", "cost"], rows)


def _row(what: str, words: list[str], seconds: float, *, subscribed: bool) -> list[str]:
    environment = {**os.environ, "ROS_DOMAIN_ID": _DOMAIN, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    with ExitStack() as running:
        running.enter_context(_process([sys.executable, __file__, "serve"], environment))
        time.sleep(_SETTLED_S)
        command = [sys.executable, "-m", "client", *words, "--robot-ip", HOST]
        process = running.enter_context(_process(command, environment))
        time.sleep(2 * _SETTLED_S)
        if subscribed:
            from client.ros2 import message_packages

            message_packages.ensure()
            running.enter_context(_process([sys.executable, __file__, "subscribe"], {**environment, **os.environ}))
            time.sleep(_SETTLED_S)
        before_s, began_s = cpu_s(process.pid), time.monotonic()
        time.sleep(seconds)
        share = (cpu_s(process.pid) - before_s) / (time.monotonic() - began_s)
    return [what, f"{share:.1%}"]


@contextmanager
def _process(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[bytes]]:
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet)
    try:
        yield process
    finally:
        process.terminate()
        process.communicate()


def _subscribe() -> None:
    import rclpy
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    rclpy.init()
    node = Node("listener")
    node.create_subscription(JointState, "/joint_states", lambda message: None, 10)
    rclpy.spin(node)


if __name__ == "__main__":
    if sys.argv[1:] == ["serve"]:
        from jitter import serve_at

        serve_at("ur5e", HOST)
    elif sys.argv[1:] == ["subscribe"]:
        _subscribe()
    else:
        sys.stdout.write(measure().markdown())
