"""Message packages that the official driver uses and this machine may lack: control_msgs, ur_msgs and others.

If a sourced ROS 2 workspace has the packages, they are imported and nothing else happens. Otherwise `ensure` builds
them once: rosidl generates code from the definitions in ``interfaces/``, a compiler builds libraries from it, and a
cache keeps the result for the next time.

The definitions depend on the distribution: the same name has other fields in Humble than in Jazzy.
``interfaces/<package>/{msg,srv,action}`` contains the definitions that all distributions share, and
``interfaces/<package>/<distribution>+<distribution>/{msg,srv,action}`` those of the named distributions. Names, types,
order and values are those of the packages in `_VERSIONS`; tests compare their type hashes with published ones.
"""

import contextlib
import hashlib
import importlib
import importlib.metadata
import importlib.util
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from client.errors import Ros2Error
from client.ros2.message_builder import KINDS, BuildPlan, is_complete, python_folder
from urproto.extras import how_to_install

Progress = Callable[[float, str], None]
"""Called with the progress, 0 to 1, and a description of the current step."""

CACHE_VARIABLE: Final = "UR_CLIENT_ROS2_CACHE"
"""Environment variable that names another folder for the packages that `ensure` builds."""

_INTERFACES: Final = Path(__file__).with_name("interfaces")
_BUILDER: Final = Path(__file__).with_name("message_builder")
# A package comes after those it refers to. Versions that the definitions were compared with, by distribution: releases
# for its binary packages (ros2-gbp) until July 2026; moveit_msgs for Jazzy is the one after its 2.6.0.
_VERSIONS: Final = {
    "control_msgs": {"humble": "4.9.0", "jazzy": "5.9.0", "kilted": "6.10.0", "lyrical": "6.10.0"},
    "controller_manager_msgs": {"humble": "2.54.0", "jazzy": "4.46.0", "kilted": "5.16.0", "lyrical": "6.8.0"},
    "octomap_msgs": {"humble": "2.0.1", "jazzy": "2.0.1", "kilted": "2.0.1", "lyrical": "2.0.1"},
    "object_recognition_msgs": {"humble": "2.0.0", "jazzy": "2.0.0", "kilted": "2.0.0", "lyrical": "2.0.0"},
    "moveit_msgs": {"humble": "2.2.1", "jazzy": "2.7.1", "kilted": "2.7.1", "lyrical": "2.7.1"},
    "tf2_msgs": {"humble": "0.25.20", "jazzy": "0.36.20", "kilted": "0.41.7", "lyrical": "0.45.7"},
    "ur_dashboard_msgs": {"humble": "2.14.0", "jazzy": "3.8.0", "kilted": "4.8.0", "lyrical": "6.0.0"},
    "ur_msgs": {"humble": "2.6.0", "jazzy": "2.6.0", "kilted": "2.6.0", "lyrical": "2.6.0"},
}
PACKAGES: Final = tuple(_VERSIONS)
DISTRIBUTIONS: Final = tuple(_VERSIONS["control_msgs"])

_SETUP_FILE: Final = "setup.sh"
_POLL_S: Final = 0.2  # between checks whether another process has finished


@dataclass(frozen=True)
class Ros2Installation:
    """The ROS 2 installation that this process would import.

    distribution: its name in lower case (``jazzy``). prefixes: its folders; the first has precedence. sourced: whether
    it is a sourced workspace; otherwise it was installed from wheels.
    """

    distribution: str
    prefixes: tuple[Path, ...]
    sourced: bool


@dataclass(frozen=True)
class MessagePackages:
    """Result of `ensure`. prefix: folder of the packages that it built; None if nothing had to be built."""

    names: tuple[str, ...] = ()
    prefix: Path | None = None

    @property
    def setup_file(self) -> Path | None:
        """File to source in a shell so that other programs (``ros2``, a user's nodes) find the packages."""
        return self.prefix / _SETUP_FILE if self.prefix else None

    def environment(self) -> dict[str, str]:
        """Environment variables with which another process finds the packages; only those that change."""
        if self.prefix is None:
            return {}
        index = os.environ.get("AMENT_PREFIX_PATH") or os.pathsep.join(map(str, find_installation().prefixes))
        modules = os.environ.get("PYTHONPATH", "")
        return {
            "AMENT_PREFIX_PATH": _joined(str(self.prefix), index),
            "PYTHONPATH": _joined(modules, str(python_folder(self.prefix))),
        }


def ensure(progress: Progress | None = None, cache: Path | None = None) -> MessagePackages:
    """Make every package of `PACKAGES` importable, in this process and in those it starts.

    Installed packages are not touched. The others come from ``cache``, or are built there, which takes a minute or two.
    A build that was interrupted resumes with the package it was at.
    If another process is already building the same packages, this one waits for it. cache: defaults to the folder in
    the environment variable UR_CLIENT_ROS2_CACHE, else ``ur-client/ros2`` in the user's cache. Raises Ros2Error.
    """
    names = missing()
    if not names:
        return MessagePackages()
    installation = find_installation()
    plan = _plan(names, installation)
    prefix = (cache or default_cache()) / _key(plan, installation)
    if not _is_whole(prefix, names):
        try:
            prefix.parent.mkdir(parents=True, exist_ok=True)
            with _lock(prefix, progress) as lock:
                if not _is_whole(prefix, names):
                    _build(plan, prefix, lock, progress)
        except OSError as error:
            raise Ros2Error(
                f"cannot build message packages in {prefix.parent} ({error.strerror or error}): make it writable, "
                f"or name another folder in {CACHE_VARIABLE}"
            ) from error
    packages = MessagePackages(names, prefix)
    os.environ.update(packages.environment())
    sys.path.append(str(python_folder(prefix)))
    importlib.invalidate_caches()
    return packages


def missing() -> tuple[str, ...]:
    return tuple(name for name in PACKAGES if not _importable(name))


def _importable(name: str) -> bool:
    spec = importlib.util.find_spec(name)
    return spec is not None and spec.origin is not None  # otherwise it is a folder that happens to have this name


def default_cache() -> Path:
    if named := os.environ.get(CACHE_VARIABLE):
        return Path(named).expanduser().absolute()
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ur-client" / "ros2"


def find_installation() -> Ros2Installation:
    """Find the ROS 2 installation. Raises Ros2Error if there is none, or if its distribution is not supported."""
    spec = importlib.util.find_spec("rclpy")
    if spec is None or spec.origin is None:
        raise Ros2Error(
            f"ROS 2 was not found: source a workspace (source /opt/ros/jazzy/setup.bash), or {how_to_install('ros2')}"
        )
    rclpy = Path(spec.origin)
    sourced = tuple(Path(prefix) for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if prefix)
    of_wheels = next((name for name in DISTRIBUTIONS if _installed(f"ros-{name}-rclpy")), "")
    if any(prefix in rclpy.parents for prefix in sourced):
        # ROS_DISTRO is not set by the setup.sh written here, which puts the folder of the wheels into the path as well
        installation = Ros2Installation(os.environ.get("ROS_DISTRO") or of_wheels, sourced, sourced=True)
    else:
        # <prefix>/lib/python3.12/site-packages/rclpy/__init__.py
        installation = Ros2Installation(of_wheels, (*sourced, rclpy.parents[4]), sourced=False)
    if installation.distribution not in DISTRIBUTIONS:
        raise Ros2Error(
            f"{', '.join(missing())} are missing. They can be built for {_either(DISTRIBUTIONS)}, but not for "
            f"{installation.distribution or 'an unknown distribution'}: install them in the workspace"
        )
    return installation


def _installed(distribution: str) -> bool:
    try:
        importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _plan(names: Sequence[str], installation: Ros2Installation) -> BuildPlan:
    distribution = installation.distribution
    packages = [(name, _VERSIONS[name][distribution], definitions(name, distribution)) for name in names]
    return BuildPlan(packages, [str(prefix) for prefix in installation.prefixes], prefix="", scratch="")


def definitions(package: str, distribution: str) -> dict[str, str]:
    """The definition of every interface of a package, by its path in the package (``msg/IOStates.msg``)."""
    folder = _INTERFACES / package
    parts = [folder, *(part for part in folder.iterdir() if distribution in part.name.split("+"))]
    files = [file for part in parts for kind in KINDS for file in part.glob(f"{kind}/*.{kind}")]
    return {f"{file.parent.name}/{file.name}": file.read_text(encoding="utf-8") for file in sorted(files)}


def _key(plan: BuildPlan, installation: Ros2Installation) -> str:
    """The folder's name, which is different for everything that the libraries depend on."""
    numpy = importlib.metadata.version("numpy").split(".")[0]
    builder = [file.read_text(encoding="utf-8") for file in sorted(_BUILDER.glob("*.py"))]
    parts = [json.dumps(plan), *builder, numpy, str(sysconfig.get_config_var("SOABI"))]
    digest = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:12]
    version = sysconfig.get_python_version()
    return f"{installation.distribution}-python{version}-{platform.machine()}-{digest}"


def _is_whole(prefix: Path, names: Sequence[str]) -> bool:
    return (prefix / _SETUP_FILE).is_file() and all(is_complete(prefix, name) for name in names)


@contextlib.contextmanager
def _lock(prefix: Path, progress: Progress | None) -> Iterator[int]:
    """Wait for other processes that build the same packages. The lock is released when all that have its file end."""
    if sys.platform == "win32":
        raise Ros2Error("message packages can only be built on Linux: install them in a ROS 2 workspace")
    import fcntl

    with open(f"{prefix}.lock", "w", encoding="utf-8") as file:
        while True:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if progress:
                    progress(0.0, "another process is building the message packages")
                time.sleep(_POLL_S)
        yield file.fileno()


def _build(plan: BuildPlan, prefix: Path, lock: int, progress: Progress | None) -> None:
    log, scratch = Path(f"{prefix}.log"), Path(f"{prefix}.scratch")
    shutil.rmtree(scratch, ignore_errors=True)  # left by a process that was killed
    try:
        scratch.mkdir()
        _run_builder(plan._replace(prefix=str(prefix), scratch=str(scratch)), log, lock, progress)
        (prefix / _SETUP_FILE).write_text(_setup_file(prefix, plan), encoding="utf-8")
        log.unlink()
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def _run_builder(plan: BuildPlan, log: Path, lock: int, progress: Progress | None) -> None:
    error = ""
    with log.open("w", encoding="utf-8") as stderr:
        builder = subprocess.Popen(
            [sys.executable, str(_BUILDER / "__main__.py")],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            env={**os.environ, "PYTHONHASHSEED": "0"},  # the order in generated code: the same source each time
            start_new_session=True,  # so that its compilers can be ended with it
            pass_fds=(lock,),  # if this process is killed, the next one waits until the builder has ended too
        )
        assert builder.stdin is not None
        assert builder.stdout is not None
        try:
            with contextlib.suppress(BrokenPipeError), builder.stdin as stdin:
                json.dump(plan._asdict(), stdin)
            for line in builder.stdout:
                part, what = line.rstrip("\n").split(" ", 1)
                if part == "error":
                    error = what
                elif progress:
                    progress(float(part), what)
        except BaseException:
            with contextlib.suppress(ProcessLookupError):
                if sys.platform != "win32":
                    os.killpg(builder.pid, signal.SIGKILL)
            raise
        finally:
            builder.stdout.close()
            builder.wait()
    if builder.returncode:
        names = ", ".join(name for name, _, _ in plan.packages)
        raise Ros2Error(f"cannot build the message packages {names}: {error or 'rosidl failed'}. Details: {log}")


def _setup_file(prefix: Path, plan: BuildPlan) -> str:
    index = os.pathsep.join(plan.prefixes)
    return (
        "# Source this, after the workspace if there is one: ros2 and other nodes then find these message packages.\n"
        f'export AMENT_PREFIX_PATH="{prefix}:${{AMENT_PREFIX_PATH:-{index}}}"\n'
        f'export PYTHONPATH="${{PYTHONPATH:+$PYTHONPATH:}}{python_folder(prefix)}"\n'
    )


def _joined(*paths: str) -> str:
    return os.pathsep.join(path for path in paths if path)


def _either(names: Sequence[str]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}"
