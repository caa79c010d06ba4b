"""What a pytest that a test starts needs to be told."""

from importlib.metadata import entry_points

__all__ = ["PLUGIN"]

# An installation of this version names the plugin itself; one from before it has to be told.
_INSTALLED = any(entry.value == "urproto.pytest_plugin" for entry in entry_points(group="pytest11"))
PLUGIN = () if _INSTALLED else ("-p", "urproto.pytest_plugin")
