"""Options for a pytest that is started by a test."""

from importlib.metadata import entry_points

__all__ = ["PLUGIN"]

# An installation of this version registers the plugin itself; an older one needs an option.
_INSTALLED = any(entry.value == "urproto.testing.pytest_plugin" for entry in entry_points(group="pytest11"))
PLUGIN = () if _INSTALLED else ("-p", "urproto.testing.pytest_plugin")
