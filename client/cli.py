"""``ur-client``: everyday tasks from a terminal, for any robot or emulator."""

import sys
from collections.abc import Mapping
from typing import Annotated, Final

import typer

from urproto.commandline import Deferred, application, load_from, version_of

_COMMANDS: Final[Mapping[str, tuple[str, str]]] = {
    "dashboard": ("robot:dashboard_command", "Send one dashboard command and print the answer."),
    "state": ("robot:state_command", "Print the robot's current state: modes, joints and TCP pose."),
    "send": ("robot:send_command", "Send a script and wait until it runs."),
    "decode": (
        "traffic:decode_command",
        "Print captured traffic of any controller port, one line per message.",
    ),
    "watch": ("robot:watch_command", "Show RTDE outputs of a robot as they change, until Ctrl-C."),
    "goal": (
        "goals:goal_command",
        "Move the arm to joint angles; Ctrl-C brings it to rest.",
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
    "record": ("record:record_command", "Record a robot's states, until Ctrl-C."),
    "stream": (
        "record:stream_command",
        "Stream a robot's live data to PlotJuggler or Foxglove, until Ctrl-C.",
    ),
    "convert": ("record:convert_command", "Convert a recording to another format."),
    "dataset": (
        "dataset:dataset_command",
        "Create a LeRobot dataset (v3.0) from recordings, with the camera images in them.",
    ),
    "plot": (
        "record:plot_command",
        "Plot a recording: desired and actual positions and speeds, their differences, and the speed scaling.",
    ),
    "trace": (
        "trace:trace_command",
        "Show a recording as a page for browsers, which works without a network and a server.",
    ),
    "fidelity": (
        "identification:fidelity_command",
        "Compare a recording of a real arm with the emulator's model of it, field by field and joint by joint.",
    ),
    "identify": (
        "identification:identify_command",
        "Identify an arm's torque constants, rotors, friction and noise from a recording of it, for ur-emulator --arm.",
    ),
    "excite": (
        "identification:excite_command",
        "Move and record every joint, within bounds around the current configuration, as data for identify.",
    ),
    "replay": (
        "record:replay_command",
        "Move the arm slowly to the start of a recorded path, then along it as recorded; Ctrl-C brings it to rest.",
    ),
    "calibration": (
        "robot:calibration_command",
        "Save the robot's calibration in the format of ur_description.",
    ),
    "describe": (
        "record:describe_command",
        "Write the URDF of an arm: joints, limits, inertias, geometry and, if available, its calibration.",
    ),
    "doctor": (
        "doctor:doctor_command",
        "Examine this machine, the network and the robot within seconds. Exit status 1 if something cannot work.",
    ),
    "mcp": ("mcp:mcp_command", "Serve tools for an assistant over standard input and output (MCP), until its end."),
    "pendant": ("pendant:pendant_command", "Serve a teach pendant for a robot or an emulator, until Ctrl-C."),
    "installation": (
        "installation:installation_app",
        "Create, show, change and check PolyScope installations, without PolyScope.",
    ),
    "program": (
        "program:program_app",
        "Create, show, compare, check and export PolyScope programs, without PolyScope.",
    ),
    "git": ("git:git_app", "Read, compare and merge PolyScope's files in a git repository."),
    "tool-comm": (
        "robot:tool_comm_command",
        "Provide the serial line at the robot's tool (e-Series) as a device on this machine, until Ctrl-C.",
    ),
    "proxy": (
        "traffic:proxy_command",
        "Relay every connection to a robot unchanged and record it, until Ctrl-C.",
    ),
    "ros2": (
        "ros2:ros2_command",
        "Run the ROS 2 driver: nodes, topics, services and actions as in ur_robot_driver. See docs/ros2.md.",
    ),
    "replay-traffic": (
        "traffic:replay_traffic_command",
        "Act as the robot of a recording, until Ctrl-C: send its states at their times and its answers to requests.",
    ),
    "compare": (
        "traffic:compare_command",
        "Report whether two recordings agree, and where they diverge. Exit status 1 if they differ.",
    ),
    "smoothness": (
        "traffic:smoothness_command",
        "Report why a streamed motion is rough: program, network, controller or arm. Exit status 1 if something is.",
    ),
    "controllers": (
        "controllers:controllers_app",
        "Run a ros2_control controller manager, and manage its controllers from other shells.",
    ),
}  # name: where it is below client.commands, and the beginning of its own help: listing it does not load it

app = application(__doc__.replace("``", ""), no_args_is_help=True)
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
