"""``ur-client``: everyday tasks from a terminal, for any robot or emulator."""

import sys
from collections.abc import Mapping
from typing import Annotated, Final

import typer

from urproto.commandline import Deferred, application, load_from, version_of

_COMMANDS: Final[Mapping[str, tuple[str, str]]] = {
    "dashboard": ("robot:dashboard_command", "Send one dashboard command and print the answer."),
    "state": ("robot:state_command", "Print what the robot is doing right now."),
    "send": ("robot:send_command", "Send a script and wait until it runs."),
    "decode": (
        "traffic:decode_command",
        "Print captured traffic of any controller port, one line per message.",
    ),
    "watch": ("robot:watch_command", "Show values of a robot as they change, until Ctrl-C."),
    "goal": (
        "goals:goal_command",
        "Move the arm to joint angles and stop there; Ctrl-C brings it to rest.",
    ),
    "plan": (
        "planning:plan_command",
        "Plan a collision-free path around obstacles, and execute it with --execute.",
    ),
    "publish-goals": (
        "goals:publish_goals_command",
        "Send the goals of a file, each once the previous one is reached; Ctrl-C brings the arm to rest.",
    ),
    "forward": (
        "goals:forward_app",
        "Command positions or speeds through a forward controller; Ctrl-C brings the arm to rest.",
    ),
    "record": ("record:record_command", "Record what a robot does, until Ctrl-C."),
    "stream": (
        "record:stream_command",
        "Stream a robot's live data to PlotJuggler or Foxglove, until Ctrl-C.",
    ),
    "convert": ("record:convert_command", "Write a recording in another format."),
    "dataset": ("dataset:dataset_command", "Make a LeRobot dataset (v3.0) of recordings, with the pictures in them."),
    "plot": (
        "record:plot_command",
        "Draw desired and actual positions and speeds, their differences and the speed scaling of a recording.",
    ),
    "fidelity": (
        "identification:fidelity_command",
        "Compare a recording of a real arm with the emulator's model of it, field by field and joint by joint.",
    ),
    "identify": (
        "identification:identify_command",
        "Find the torque constants, rotors, friction and noise of an arm in a recording of it, for ur-emulator --arm.",
    ),
    "excite": (
        "identification:excite_command",
        "Move every joint, within bounds around where the arm is, so that identify sees everything, and record it.",
    ),
    "replay": (
        "record:replay_command",
        "Move the arm along the recorded path: slowly to its start, then as recorded; Ctrl-C brings it to rest.",
    ),
    "calibration": (
        "robot:calibration_command",
        "Write the robot's calibration in the format of ur_description.",
    ),
    "describe": (
        "record:describe_command",
        "Write the URDF of an arm: joints, limits, inertias, geometry and, if there is one, calibration.",
    ),
    "doctor": (
        "doctor:doctor_command",
        "Examine this machine, the network and the robot, in some seconds. Exit status 1 if something cannot work.",
    ),
    "pendant": ("pendant:pendant_command", "Serve a teach pendant for a robot or an emulator, until Ctrl-C."),
    "installation": ("installation:installation_app", "PolyScope installations, without PolyScope."),
    "program": ("program:program_app", "PolyScope programs, without PolyScope."),
    "tool-comm": (
        "robot:tool_comm_command",
        "Make the serial line at the robot's tool (e-Series) a device of this machine, until Ctrl-C.",
    ),
    "proxy": (
        "traffic:proxy_command",
        "Relay every connection to a robot unchanged and record it, until Ctrl-C.",
    ),
    "ros2": (
        "ros2:ros2_command",
        "Run the ROS 2 driver: nodes, topics, services and actions as of ur_robot_driver. See docs/ros2.md.",
    ),
    "replay-traffic": (
        "traffic:replay_traffic_command",
        "Stand in for the robot of a recording, until Ctrl-C: states at their times, answers to their requests.",
    ),
    "compare": (
        "traffic:compare_command",
        "Show whether two recordings agree, and where they diverge; exit status 1 when they differ.",
    ),
    "controllers": (
        "controllers:controllers_app",
        "ros2_control's controllers: a manager that runs, and what other shells ask of it.",
    ),
}  # name: where it is below client.commands, and the beginning of its own help: listing it does not load it

app = application(__doc__, no_args_is_help=True)
for _name, (_place, _help) in _COMMANDS.items():
    app.command(_name, cls=Deferred, help=_help)(load_from(f"client.commands.{_place}"))


@app.callback()
def _options(*, version: Annotated[bool, version_of("ur-client")] = False) -> None:
    pass


def main() -> None:
    """Entry point of ``ur-client``: errors are one line, exit status 1."""
    try:
        app()
    except Exception as error:
        if not isinstance(error, _explained()):
            raise
        typer.echo(f"ur-client: {error}", err=True)
        sys.exit(1)


def _explained() -> tuple[type[Exception], ...]:
    """Errors that say all there is to say. Their module is loaded when there is one."""
    from urproto.errors import URError

    return URError, UnicodeDecodeError
