"""Which part of a package may import which. `test_architecture` enforces it, docs/reference/layers.md shows it."""

from typing import NamedTuple

# From the bottom up: a part (a module or folder of the package) may import parts on lower levels, and none on its own
# level. Imports under TYPE_CHECKING or inside a function count as well.
EMULATOR_LEVELS = (
    ("ports", "devices", "logs", "clock", "realtime", "workshare", "on_demand"),
    ("snapshot",),
    ("lifecycle", "reporting"),
    ("robot",),
    ("io", "motion"),
    ("world", "services"),
    ("physics", "machine"),
    ("fieldbus", "safety", "mailbox", "reports"),
    ("builtins",),
    ("programs",),
    ("guard", "startup"),
    ("controller",),
    ("commands",),
    ("servers",),
    ("faults", "robotapi"),
    ("control",),
    ("config", "readiness"),
    ("journal",),
    ("app", "batch", "peers", "check", "ctl", "facts_command", "options"),
    ("first_screen", "pendant_process", "script_run", "script_options", "branches"),
    ("serve", "scripttest", "virtual"),
    ("debugger", "learning", "lockstep", "replay_command", "trace_command"),
    ("script_cli",),
    ("fleet", "campaign", "explore"),
    ("evaluation",),
    ("cli",),
    ("__main__",),
)


class Layer(NamedTuple):
    """A part of a package: its description, its modules with their submodules, and the other parts it may import."""

    description: str
    modules: tuple[str, ...]
    may_import: tuple[str, ...] = ()


# parts of `client`, from the bottom up: a part may import only parts that are listed before it
CLIENT_LAYERS: dict[str, Layer] = {
    "ports": Layer(
        "driver library: a client for each port of a controller, and their errors",
        (
            "client.calibration",
            "client.connection",
            "client.dashboard",
            "client.dashboard_commands",
            "client.errors",
            "client.gripper",
            "client.modbus",
            "client.primary",
            "client.quantities",
            "client.realtime",
            "client.blocking",
            "client.robotapi",
            "client.rtde",
            "client.scripts",
            "client.tool_communication",
        ),
    ),
    "cameras": Layer("driver library: camera pictures", ("client.cameras",), ("ports",)),
    "planning": Layer("driver library: motion planning around obstacles", ("client.planning",), ("ports",)),
    "driver": Layer("driver library: External Control", ("client.driver",), ("ports",)),
    "robot": Layer(
        "driver library: the `Robot` class for most programs", ("client.robot",), ("ports", "planning", "driver")
    ),
    "facade": Layer("driver library: public names of `import client`", ("client",), ("ports", "driver", "robot")),
    "recording": Layer(
        "recordings: writing, reading, plotting, streaming",
        ("client.recording",),
        ("ports", "cameras", "driver", "robot"),
    ),
    "identification": Layer(
        "recordings of a real arm: accuracy of its model, identification of a better one",
        ("client.identification",),
        ("ports", "recording"),
    ),
    "lerobot": Layer(
        "recordings as datasets for training policies; a robot of LeRobot",
        ("client.lerobot",),
        ("ports", "cameras", "robot", "recording"),
    ),
    "programs": Layer("program trees: opening, checking, saving", ("client.programs",), ("ports",)),
    "difference_page": Layer(
        "program trees: the page of a comparison", ("client.difference_page",), ("ports", "recording", "programs")
    ),
    "decoding": Layer("traffic: captured bytes in readable form", ("client.decoding",)),
    "traffic": Layer("traffic: recording, replay, comparison", ("client.traffic",), ("ports", "decoding")),
    "controllers": Layer(
        "ros2_control's controllers without ROS", ("client.controllers",), ("ports", "driver", "robot", "recording")
    ),
    "ros2": Layer("ROS 2", ("client.ros2",), ("ports", "cameras", "planning", "driver", "robot", "controllers")),
    "pendant": Layer(
        "teach pendant",
        ("client.pendant",),
        ("ports", "planning", "driver", "robot", "recording", "controllers", "programs"),
    ),
    "doctor": Layer(
        "command line: checks of this machine and its connection to a robot", ("client.doctor",), ("ports", "driver")
    ),
    "mcp": Layer(
        "command line: tools for assistants",
        ("client.mcp",),
        ("ports", "cameras", "driver", "robot", "programs"),
    ),
    "commands": Layer(
        "command line: `ur-client`",
        ("client.cli", "client.commands", "client.__main__"),
        (
            "ports",
            "cameras",
            "planning",
            "driver",
            "robot",
            "recording",
            "identification",
            "lerobot",
            "decoding",
            "traffic",
            "controllers",
            "ros2",
            "pendant",
            "programs",
            "difference_page",
            "doctor",
            "mcp",
        ),
    ),
}
