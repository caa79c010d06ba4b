"""pytest in a separate process, with the plugin as installed by a user."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # the helper next to this file; importlib mode does not add its folder

from tests_of_users import PLUGIN

# Plug-ins of this project's own tests, which users need not have, take two thirds of the time until pytest is ready.
_WITHOUT = ("cacheprovider", "hypothesispytest", "pytest-lsp")
_QUIET = (*(f"-pno:{name}" for name in _WITHOUT), "-W", "ignore::pytest.PytestDeprecationWarning")
PATIENCE_S = 100.0

if sys.platform != "linux":  # leaked ports are detected, and separate loopback addresses exist, on Linux
    collect_ignore_glob = ["test_*"]

RunTests = Callable[..., pytest.RunResult]


@pytest.fixture
def run_tests(pytester: pytest.Pytester) -> RunTests:
    """Run a file of tests with these options of pytest; the outcome."""

    def run(source: str, *options: str) -> pytest.RunResult:
        pytester.makepyfile(source)
        command = [sys.executable, "-m", "pytest", *PLUGIN, *_QUIET, *options]
        return pytester.run(*command, timeout=PATIENCE_S)

    return run
