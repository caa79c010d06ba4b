"""pytest in a process of its own, with the plugin as a user has it."""

import sys
from collections.abc import Callable
from importlib.metadata import entry_points

import pytest

# An installation of this version names the plugin itself; one from before it has to be told.
_INSTALLED = any(entry.value == "urproto.pytest_plugin" for entry in entry_points(group="pytest11"))
_PLUGIN = () if _INSTALLED else ("-p", "urproto.pytest_plugin")
_QUIET = ("-p", "no:cacheprovider", "-W", "ignore::pytest.PytestDeprecationWarning")
PATIENCE_S = 100.0

if sys.platform != "linux":  # leaks of ports are seen, and own addresses there are, on Linux
    collect_ignore_glob = ["test_*"]

RunTests = Callable[..., pytest.RunResult]


@pytest.fixture
def run_tests(pytester: pytest.Pytester) -> RunTests:
    """Run a file of tests with these options of pytest; the outcome."""

    def run(source: str, *options: str) -> pytest.RunResult:
        pytester.makepyfile(source)
        command = [sys.executable, "-m", "pytest", *_PLUGIN, *_QUIET, *options]
        return pytester.run(*command, timeout=PATIENCE_S)

    return run
