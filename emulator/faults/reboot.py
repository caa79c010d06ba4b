"""What of a robot outlives its controller."""

from dataclasses import replace

from emulator.controller import Controller
from urproto.modes import JointMode, RobotMode, RuntimeState, ToolMode

__all__ = ["rebooted", "show_gone"]


def show_gone(controller: Controller) -> None:
    """Let the last snapshot say that there is no controller, to those who look behind the scenes."""
    snapshot = controller.snapshot.successor()
    snapshot.robot_mode = RobotMode.NO_CONTROLLER
    snapshot.joint_mode = (JointMode.NOT_RESPONDING,) * 6
    snapshot.tool_mode = ToolMode.NOT_RESPONDING
    snapshot.runtime_state = RuntimeState.STOPPED
    snapshot.program_running = snapshot.program_paused = False
    snapshot.messages = ()
    controller.snapshot = snapshot


def rebooted(before: Controller, boot_s: float, outage_s: float) -> Controller:
    """The controller after a restart: uptime 0, booting, the arm off where it stood, the calendar gone on."""
    config = before.config
    wall_clock_s = before.wall_clock_ns / 1e9 + outage_s
    timings = replace(config.timings, controller_boot_s=boot_s)
    config = replace(
        config, uptime_s=0.0, running=False, initial_q=before.motion.q, wall_clock_s=wall_clock_s, timings=timings
    )
    return Controller(config)
