"""Who may stand on whom inside a package. `test_architecture` enforces it, docs/architecture.md shows it."""

# From the ground up: a part (a module or folder of the package) may import what stands on floors below its own, and
# nothing beside it. An import is an import, also in an if TYPE_CHECKING or inside a function.
EMULATOR_FLOORS = (
    ("ports", "devices", "logs", "clock", "realtime"),
    ("snapshot",),
    ("lifecycle", "polyscope", "reporting"),
    ("robot",),
    ("io", "motion"),
    ("world", "services"),
    ("machine",),
    ("fieldbus", "safety", "mailbox", "reports"),
    ("builtins",),
    ("programs",),
    ("guard", "startup"),
    ("controller",),
    ("commands",),
    ("servers",),
    ("faults",),
    ("control",),
    ("config", "readiness"),
    ("app", "batch", "script_peers", "check", "ctl"),
    ("serve", "script_run"),
    ("run_command", "cli"),
    ("fleet",),
    ("__main__",),
)
