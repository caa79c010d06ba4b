"""The packages to build, the ROS 2 installation, and the resulting ament prefix."""

import json
import shutil
import sysconfig
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

KINDS: Final = ("msg", "srv", "action")
# rosidl's additions to services and actions refer to these, if the distribution has them
_IMPLIED: Final = ("builtin_interfaces", "service_msgs", "action_msgs", "unique_identifier_msgs")
FASTRTPS: Final = "rosidl_typesupport_fastrtps_c"
INTROSPECTION: Final = "rosidl_typesupport_introspection_c"


class BuildPlan(NamedTuple):
    """The packages to build, and where.

    packages: name, version, and files by their path in the package (``msg/IOStates.msg``); a package comes after those
    that it refers to. prefixes: prefixes of the ROS 2 installation, the first has precedence. prefix: the folder to
    build in; packages that are complete there stay. scratch: empty folder for temporary files.
    """

    packages: list[tuple[str, str, dict[str, str]]]
    prefixes: list[str]
    prefix: str
    scratch: str


class BuildError(Exception):
    """A build failed; the text is for the user, details are on standard error."""


@dataclass(frozen=True)
class InterfacePackage:
    """A package of the plan. dependencies: packages that it refers to."""

    name: str
    version: str
    files: dict[str, str]
    prefix: Path
    dependencies: tuple[str, ...]

    @property
    def share(self) -> Path:
        return self.prefix / "share" / self.name

    def idl_tuples(self) -> list[str]:
        return [f"{self.share}:{Path(file).with_suffix('.idl')}" for file in self.files]


class RosInstallation:
    """The ROS 2 installation."""

    def __init__(self, prefixes: Sequence[Path]) -> None:
        self.prefixes = prefixes
        # the registered ones, which the dispatcher searches
        self.typesupports = [name for name in (FASTRTPS, INTROSPECTION) if self.has("rosidl_typesupport_c", name)]
        if not self.typesupports:
            raise BuildError(f"no type support for C is registered in {', '.join(map(str, prefixes))}")

    def has(self, resource: str, name: str) -> bool:
        return any(
            (prefix / "share/ament_index/resource_index" / resource / name).is_file() for prefix in self.prefixes
        )

    def share(self, package: str) -> Path:
        for prefix in self.prefixes:
            if (share := prefix / "share" / package).is_dir():
                return share
        raise BuildError(f"the ROS 2 package {package} is not installed")

    def include(self) -> Iterator[Path]:
        """Folders of headers: a package's are either in ``include/<package>`` or in ``include/<package>/<package>``."""
        for prefix in self.prefixes:
            yield prefix / "include"
            yield from sorted(path.parent for path in prefix.glob("include/*/*/") if path.name == path.parent.name)

    def libraries(self) -> Iterator[Path]:
        for prefix in self.prefixes:
            yield prefix / "lib"
            if multiarch := sysconfig.get_config_var("MULTIARCH"):
                yield prefix / "lib" / multiarch


def packages_of(plan: BuildPlan, installation: RosInstallation) -> list[InterfacePackage]:
    """The packages of a plan, in its order."""
    implied = {name for name in _IMPLIED if installation.has("packages", name)}
    packages = []
    for name, version, files in plan.packages:
        dependencies = set(implied)
        for text in files.values():
            dependencies |= {line.split("/")[0] for line in text.splitlines() if "/" in line.split(" ")[0]}
        packages.append(InterfacePackage(name, version, files, Path(plan.prefix), tuple(sorted(dependencies - {name}))))
    return packages


def python_folder(prefix: Path) -> Path:
    """The folder of the Python packages of a prefix."""
    return prefix / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"


def is_complete(prefix: Path, package: str) -> bool:
    """Whether a package was built completely, and still has all its files."""
    try:
        files = json.loads(_manifest(prefix, package).read_text(encoding="utf-8"))
        return all((prefix / name).stat().st_size == size for name, size in files.items())
    except (OSError, ValueError, AttributeError):
        return False


def record(prefix: Path, package: str) -> None:
    """Record the files of a package that was built completely, for `is_complete`."""
    patterns = (
        f"lib/lib{package}__*.so",
        f"share/{package}/**/*",
        f"share/ament_index/resource_index/*/{package}",
        f"{python_folder(Path())}/{package}/**/*",
    )
    found = [path for pattern in patterns for path in prefix.glob(pattern) if path.is_file()]
    manifest = _manifest(prefix, package)
    manifest.parent.mkdir(exist_ok=True)
    manifest.write_text(json.dumps({str(path.relative_to(prefix)): path.stat().st_size for path in found}))


def _manifest(prefix: Path, package: str) -> Path:
    return prefix / "manifests" / f"{package}.json"


def install_python(package: InterfacePackage, output: Path) -> None:
    """Install the Python package from the output of its generator."""
    target = python_folder(package.prefix) / package.name
    (target / "__init__.py").write_text("", encoding="utf-8")
    for kind in KINDS:
        for module in (output / kind).glob("*.py"):
            (target / kind).mkdir(exist_ok=True)
            shutil.copy(module, target / kind)


def register(package: InterfacePackage) -> None:
    """Add a package to the ament index, in which the ros2 commands find packages and interfaces."""
    index = package.prefix / "share/ament_index/resource_index"
    interfaces = sorted(
        path.relative_to(package.share).as_posix() for path in package.share.glob("*/*") if path.suffix != ".json"
    )
    resources = {
        "packages": "",
        "package_run_dependencies": ";".join(package.dependencies),
        "rosidl_interfaces": "\n".join(interfaces),
    }
    for resource, content in resources.items():
        (index / resource).mkdir(parents=True, exist_ok=True)
        (index / resource / package.name).write_text(content, encoding="utf-8")
    (package.share / "package.xml").write_text(
        f'<package format="3"><name>{package.name}</name><version>{package.version}</version>'
        "<description>Interfaces</description><member_of_group>rosidl_interface_packages</member_of_group></package>\n",
        encoding="utf-8",
    )
