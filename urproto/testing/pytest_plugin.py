"""The pytest plugin: the fixtures ``ur_emulator`` and ``ur_robot``, and tests in URScript. See docs/testing.md.

The plugin hardly slows down other pytest runs: the fixtures' dependencies are imported when a test requests one.
"""

import re
from base64 import b64decode
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import pytest

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Iterable

    from emulator.virtual import VirtualRobot
    from urproto.testing.leaks import Resources
    from urproto.testing.process import EmulatorProcess

_DEFAULT_MODEL: Final = "ur3"
_FIXTURES: Final = {"ur_emulator", "ur_robot", "make_ur_emulator"}
_MARKERS: Final = (
    "ur_model(model=None, **options): arm model of ur_emulator or ur_robot, and options of ur-emulator, for example "
    'ur_model("ur5e", polyscope="5.12", running=True, speed=10)',
    "ur_leaves_things: let a test with an emulated robot leave threads, tasks or listening ports behind",
)

_started: "pytest.StashKey[list[EmulatorProcess]]" = pytest.StashKey()
_journals: "pytest.StashKey[tuple[Path, dict[str, Callable[[], bytes]]]]" = pytest.StashKey()  # of a test's robots
_failed: "pytest.StashKey[bool]" = pytest.StashKey()
_allowed: "pytest.StashKey[Resources | None]" = pytest.StashKey()  # of the current test, if it uses robots


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add options for the defaults of the markers."""
    group = parser.getgroup("ur_emulator", "emulated Universal Robots")
    group.addoption("--ur-model", metavar="NAME", help=f"arm for tests that do not name one (default {_DEFAULT_MODEL})")
    group.addoption("--ur-polyscope", metavar="VERSION", help="PolyScope version of that arm")
    group.addoption(
        "--ur-option",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="an option of ur-emulator for tests that do not give it, for example seed=3, arm=dynamic or "
        "fault=joint_fault,joint=2; repeatable, also the same one",
    )
    parser.addini("ur_script_tests", "collect test_*.script and *_test.script", type="bool", default=False)


def pytest_configure(config: pytest.Config) -> None:
    for marker in _MARKERS:
        config.addinivalue_line("markers", marker)


# fixtures


class MakeEmulator(Protocol):
    """Starts an emulator that is stopped at the end of the test."""

    def __call__(self, model: str | None = None, **options: Any) -> "EmulatorProcess": ...


@pytest.fixture
def make_ur_emulator(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, _ur_tasks: None
) -> Iterator[MakeEmulator]:
    """A function that starts emulators with the options of the marker ``ur_model``, each on its own address."""
    from urproto.testing.process import EmulatorProcess, command_line, write_positions

    emulators = request.node.stash[_started] = []
    _, journals = request.node.stash[_journals] = tmp_path_factory.getbasetemp(), {}

    def make(model: str | None = None, **options: Any) -> EmulatorProcess:
        __tracebackhide__ = True
        options = _with_defaults(request.config, {"model": model, **options})
        token = options.pop("control_token", "")
        if (q_rad := options.pop("initial_q", None)) is not None:
            options["initial_positions"] = write_positions(tmp_path_factory.mktemp("ur") / "positions.yaml", q_rad)
        emulators.append(started := EmulatorProcess(command_line({"no_stop_journals": True, **options}), token=token))
        journals[f"ur_emulator {started.host}"] = lambda: b64decode(started.journal())
        return started.start()

    try:
        yield make
    finally:
        crashed = [emulator for emulator in emulators if emulator.crashed]
        complaints = [f"the emulator ended with status {one.status}:\n{one.output}" for one in crashed]
        for emulator in emulators:
            emulator.dispose()
    if complaints:
        pytest.fail("\n".join(complaints), pytrace=False)


@pytest.fixture
def ur_emulator(request: pytest.FixtureRequest, make_ur_emulator: MakeEmulator) -> "EmulatorProcess":
    """An emulator in a separate process: ``host``, ``ports``, and the verbs of its control API as methods."""
    __tracebackhide__ = True
    return make_ur_emulator(**_marked_options(request.node))


@pytest.fixture
def ur_robot(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, _ur_tasks: None
) -> "Iterator[VirtualRobot]":
    """A robot in this process, in virtual time and without ports: the verbs of the control API as methods."""
    __tracebackhide__ = True
    from urproto.testing import virtual_robot

    robot = virtual_robot(**_with_defaults(request.config, _marked_options(request.node)), checked=True)
    request.node.stash[_journals] = tmp_path_factory.getbasetemp(), {"ur_robot": lambda: robot.journal}
    began_s = robot.controller.time_s
    yield robot
    request.node.user_properties.append(("ur_robot_s", robot.controller.time_s - began_s))


@pytest.fixture
def ur_explore(ur_seed: int) -> Callable[..., None]:
    """A function that explores a plan (a YAML file) for a number of runs, and fails with what breaks a property."""
    __tracebackhide__ = True
    from urproto.testing import virtual_robot as _  # noqa: F401 now that the package is known to be this one

    def explore(plan: str | Path, runs: int = 100, seed: int | None = None) -> None:
        __tracebackhide__ = True
        from emulator.explore.answer import explanation

        if found := explanation(Path(plan), runs, ur_seed if seed is None else seed):
            pytest.fail(found, pytrace=False)

    return explore


@pytest.fixture
def ur_seed(request: pytest.FixtureRequest) -> int:
    """A seed for the random choices of a test: that of ``--ur-option seed=N``, else 0. Campaigns vary it."""
    return int(_named_options(request.config).get("seed", 0))


def _marked_options(node: pytest.Item) -> dict[str, Any]:
    """The options of all markers of a test; the closest marker takes precedence."""
    options: dict[str, Any] = {}
    for marker in reversed(list(node.iter_markers("ur_model"))):
        if len(marker.args) > 1:
            raise pytest.UsageError(f"ur_model takes a model and named options, not {marker.args}")
        options |= {"model": marker.args[0]} if marker.args else {}
        options |= marker.kwargs
    return options


def _with_defaults(config: pytest.Config, options: Mapping[str, Any]) -> dict[str, Any]:
    """Add the options of the command line that a test does not give; the version only if it names no model."""
    options = {**_named_options(config), **options}
    if options.get("model") is not None:
        return options
    model = config.getoption("--ur-model") or _DEFAULT_MODEL
    polyscope = options.get("polyscope", config.getoption("--ur-polyscope"))
    return {**options, "model": model, "polyscope": polyscope}


def _named_options(config: pytest.Config) -> dict[str, Any]:
    """The options of ``--ur-option``: true, false and numbers are converted, and a repeated option becomes a list."""
    options: dict[str, Any] = {}
    for text in config.getoption("--ur-option"):
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals or not name or name in ("model", "polyscope"):
            raise pytest.UsageError(f"--ur-option {text}: use NAME=VALUE, or --ur-model and --ur-polyscope")
        if name in options:
            earlier = options[name] if isinstance(options[name], list) else [options[name]]
            options[name] = [*earlier, _typed(value)]
        else:
            options[name] = _typed(value)
    return options


def _typed(text: str) -> bool | int | float | str:
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return {"true": True, "false": False}.get(text.lower(), text)


# leaks


@pytest.fixture
def _ur_tasks(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves asyncio tasks in the event loop that pytest-asyncio runs it in."""
    runners = [name for name in request.fixturenames if name.endswith("_scoped_runner")]
    loops = [request.getfixturevalue(name).get_loop() for name in runners]  # so they end after this fixture
    before = _tasks(loops)
    yield
    left = _tasks(loops) - before
    if left and _is_checked_for_leaks(request.node):
        names = ", ".join(sorted(f"{task.get_name()} ({_coroutine_name(task)})" for task in left))
        _fail_for_leaks([f"asyncio tasks: {names}"])


def _tasks(loops: "list[asyncio.AbstractEventLoop]") -> "set[asyncio.Task[Any]]":
    if not loops:
        return set()
    import asyncio

    return {task for loop in loops for task in asyncio.all_tasks(loop)}


def _coroutine_name(task: "asyncio.Task[Any]") -> str:
    return getattr(task.get_coro(), "__qualname__", "?")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None, object, object]:
    __tracebackhide__ = True
    item.stash[_failed] = False
    if _uses_robots(item):
        from urproto.testing.leaks import Resources

        item.config.stash[_allowed] = Resources.now()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(
    fixturedef: "pytest.FixtureDef[Any]", request: pytest.FixtureRequest
) -> Generator[None, object, object]:
    """Accept what a fixture of a wider scope starts: it may outlive the test that first requests the fixture."""
    __tracebackhide__ = True
    allowed = request.config.stash.get(_allowed, None)
    if allowed is None or fixturedef.scope == "function":
        return (yield)
    before = allowed.now()
    result = yield
    allowed.add(before.new())
    return result


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item: pytest.Item) -> Generator[None, object, object]:
    __tracebackhide__ = True
    try:
        result = yield
    finally:
        allowed = item.config.stash.get(_allowed, None)
        item.config.stash[_allowed] = None
    if allowed is not None and _is_checked_for_leaks(item) and (complaints := allowed.leaks()):
        _fail_for_leaks(complaints)
    return result


def _uses_robots(item: pytest.Item) -> bool:
    return not _FIXTURES.isdisjoint(getattr(item, "fixturenames", ()))


def _is_checked_for_leaks(item: pytest.Item) -> bool:
    """Whether a test is checked for leaks. A failed test rarely cleans up, and its failure is report enough."""
    return not item.stash.get(_failed, False) and item.get_closest_marker("ur_leaves_things") is None


def _fail_for_leaks(left: list[str]) -> None:
    pytest.fail("left behind by the test: " + "; ".join(left), pytrace=False)


# tests in URScript


def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> "ScriptTests | None":
    """Test files in URScript: those named on the command line and, with ``ur_script_tests``, those in folders."""
    if file_path.suffix != ".script":
        return None
    named = parent.session.isinitpath(file_path)
    if not named and not parent.config.getini("ur_script_tests"):
        return None
    from urscript.scripttest.suite import is_test_file

    return ScriptTests.from_parent(parent, path=file_path) if named or is_test_file(file_path) else None


class ScriptTests(pytest.File):
    """A file of tests in URScript."""

    def collect(self) -> "Iterable[ScriptTest]":
        from urscript.errors import ScriptError
        from urscript.scripttest.suite import SuiteError, tests_of

        try:
            return [ScriptTest.from_parent(self, name=test.name, test=test) for test in tests_of(self.path)]
        except SuiteError as error:
            raise self.CollectError(str(error)) from error
        except ScriptError as error:
            raise self.CollectError(error.render(str(self.path))) from error


class ScriptTest(pytest.Item):
    """A test in URScript; ``--ur-model`` and ``--ur-polyscope`` apply unless its settings name an arm."""

    funcargs: Final[Mapping[str, Any]] = {}  # plugins such as pytest-lsp expect them of every test

    def __init__(self, *, test: Any, **others: Any) -> None:
        super().__init__(**others)
        self.test = test

    def runtest(self) -> None:
        """Run it on a new robot."""
        from emulator.scripttest.runner import Status, run_test

        names = ("model", "polyscope")
        defaults = {name: value for name in names if (value := self.config.getoption(f"--ur-{name}"))}
        result = run_test(self.test, defaults)
        self.user_properties.append(("ur_robot_s", result.robot_s))
        self.add_report_section("call", "URScript", "\n".join(result.lines))
        if result.status is not Status.PASSED:
            pytest.fail(result.failure, pytrace=False)

    def reportinfo(self) -> tuple[Path, int, str]:
        return self.path, self.test.line - 1, self.name


# reports of failures


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: "pytest.CallInfo[None]"
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.failed:
        item.stash[_failed] = True
        for emulator in item.stash.get(_started, []):
            report.sections += [
                (f"ur_emulator {emulator.host}: {name}", text) for name, text in emulator.explanation().items()
            ]
        report.sections += [(f"{name}: see it again", f"ur-emulator replay {path}") for name, path in _written(item)]
    return report


def _written(item: pytest.Item) -> Iterator[tuple[str, Path]]:
    """Write the journals of a failed test's robots; yields the robots' names and the files."""
    folder, journals = item.stash.get(_journals, (Path(), {}))
    for name, journal in journals.items():
        with suppress(Exception):  # the robot may be what failed
            path = folder / f"{re.sub(r'[^A-Za-z0-9.]+', '_', f'{item.name} {name}')}.journal"
            if content := journal():
                path.write_bytes(content)
                yield name, path
