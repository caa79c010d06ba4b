"""Who may stand on whom inside a package. `test_architecture` enforces it, docs/architecture.md shows it."""

from typing import NamedTuple

# From the ground up: a part (a module or folder of the package) may import what stands on floors below its own, and
# nothing beside it. An import is an import, also in an if TYPE_CHECKING or inside a function.
EMULATOR_FLOORS = (
    ("ports", "devices", "logs", "clock", "realtime"),
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
    ("app", "batch", "script_peers", "check", "ctl", "learning"),
    ("serve", "script_run"),
    ("run_command", "cli"),
    ("fleet", "campaign"),
    ("__main__",),
)


class Layer(NamedTuple):
    """A part of a package: what it is, the modules in it (with all below them), and the other parts it may import."""

    what: str
    modules: tuple[str, ...]
    may_import: tuple[str, ...] = ()


# who in `client` may import whom, from the bottom to the top: a part imports only parts that stand above it here
CLIENT_LAYERS: dict[str, Layer] = {
    "ports": Layer(
        "driver library: one client for each port of a controller, and what goes wrong with any",
        (
            "client.calibration",
            "client.connection",
            "client.dashboard",
            "client.dashboard_commands",
            "client.dashboard_on_x",
            "client.errors",
            "client.modbus",
            "client.primary",
            "client.realtime",
            "client.robotapi",
            "client.rtde",
            "client.scripts",
            "client.tool_communication",
        ),
    ),
    "cameras": Layer("driver library: pictures of cameras", ("client.cameras",), ("ports",)),
    "planning": Layer("driver library: motion planning around obstacles", ("client.planning",), ("ports",)),
    "driver": Layer("driver library: External Control", ("client.driver",), ("ports",)),
    "robot": Layer(
        "driver library: the robot that most programs want", ("client.robot",), ("ports", "planning", "driver")
    ),
    "face": Layer("driver library: the names that `import client` gives", ("client",), ("ports", "driver", "robot")),
    "recording": Layer(
        "recordings: written, read, drawn, streamed", ("client.recording",), ("ports", "cameras", "driver", "robot")
    ),
    "identification": Layer(
        "recordings of a real arm: how far its model is right, and what a better one is",
        ("client.identification",),
        ("ports", "recording"),
    ),
    "lerobot": Layer(
        "recordings as datasets that policies are trained on", ("client.lerobot",), ("ports", "recording")
    ),
    "programs": Layer("program trees: opened, checked, saved", ("client.programs",), ("ports",)),
    "decoding": Layer("traffic: captured bytes shown to people", ("client.decoding",)),
    "traffic": Layer("traffic: recorded, replayed, compared", ("client.traffic",), ("ports", "decoding")),
    "controllers": Layer(
        "ros2_control's controllers without ROS", ("client.controllers",), ("ports", "driver", "robot", "recording")
    ),
    "ros2": Layer("ROS 2", ("client.ros2",), ("ports", "cameras", "planning", "driver", "robot", "controllers")),
    "pendant": Layer(
        "teach pendant",
        ("client.pendant",),
        ("ports", "planning", "driver", "robot", "recording", "controllers", "programs"),
    ),
    "doctor": Layer("command line: what is between this machine and a robot", ("client.doctor",), ("ports", "driver")),
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
            "doctor",
        ),
    ),
}
