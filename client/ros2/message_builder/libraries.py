"""Builds libraries from generated code with this machine's compiler."""

import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

from client.ros2.message_builder.packages import (
    FASTRTPS,
    INTROSPECTION,
    KINDS,
    BuildError,
    InterfacePackage,
    RosInstallation,
    python_folder,
)
from client.ros2.message_builder.rosidl import DISPATCH, PYTHON, C, Generators, Report

_FILES_PER_UNIT: Final = 12  # per translation unit: headers take most of the time, and are then read once


class LibraryKind(NamedTuple):
    """One of the libraries that rosidl builds for a package, lib<package>__<name>.so, from the generator of that name.

    dependencies: libraries of the same package. ros_dependencies: libraries of the installation. Libraries of the same
    name of the packages that it refers to are linked in any case. keep_unused: whether the libraries of its package are
    loaded with it although it uses none of their symbols: the dispatcher finds them with dlopen once they are loaded.
    """

    name: str
    dependencies: tuple[str, ...] = ()
    ros_dependencies: tuple[str, ...] = ()
    keep_unused: bool = False


_LIBRARIES: Final = (
    LibraryKind(C, (), ("rosidl_runtime_c", "rcutils")),
    LibraryKind(
        FASTRTPS,
        (C,),
        (FASTRTPS, "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw", "rosidl_runtime_c", "rcutils"),
    ),
    LibraryKind(INTROSPECTION, (C,), (INTROSPECTION, "rosidl_runtime_c")),
    LibraryKind(DISPATCH, (C, FASTRTPS, INTROSPECTION), (DISPATCH, "rosidl_runtime_c"), keep_unused=True),
    LibraryKind(PYTHON, (C, DISPATCH), ("rosidl_runtime_c",)),
)


class Compiler:
    """A C and a C++ compiler, called directly."""

    def __init__(self, installation: RosInstallation, scratch: Path) -> None:
        self._c = _find_compiler("CC", "cc", "gcc", "clang")
        self._cpp = _find_compiler("CXX", "c++", "g++", "clang++")
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
        compiler_command = [self._cpp, "-std=c++17"] if source.suffix == ".cpp" else [self._c, "-std=gnu11"]
        folders = [f"-I{folder}" for folder in [*include, *self._include]]
        is_table = source.stem.endswith("__description") or ".ep." in source.name  # need not be fast
        optimisation = "-O0" if is_table else "-O1"
        options = [optimisation, "-fPIC", "-w", "-DNDEBUG", f'-DROS_PACKAGE_NAME="{package}"']
        _run([*compiler_command, *options, *folders, "-c", str(source), "-o", str(target)])
        return target

    def link(
        self, target: Path, objects: Sequence[Path], names: Sequence[str], library_path: str, *, keep_unused: bool
    ) -> None:
        """Link ``objects`` and the libraries of these names, as far as they exist, to a library.

        library_path: path from its folder to that of the other libraries. keep_unused: see `LibraryKind`.
        """
        target.parent.mkdir(parents=True, exist_ok=True)
        folders = [target.parent / library_path, *self._libraries]
        found = [name for name in names if any((folder / f"lib{name}.so").exists() for folder in folders)]
        command = [self._cpp, "-shared", "-o", str(target), f"-Wl,-soname,{target.name}", *map(str, objects)]
        command += ["-Wl,--no-as-needed" if keep_unused else "-Wl,--as-needed"]
        command += [f"-L{folder}" for folder in folders]
        command += [f"-Wl,-rpath,{folder}" for folder in (f"$ORIGIN/{library_path}", *self._libraries)]
        _run(command + [f"-l{name}" for name in found])


def _find_compiler(variable: str, *names: str) -> str:
    for name in [os.environ.get(variable, ""), *names]:
        if name and (path := shutil.which(name)):
            return path
    raise BuildError(
        f"no compiler: none of {', '.join(names)} was found (Ubuntu: sudo apt install build-essential; or name one in "
        f"the environment variable {variable})"
    )


def _run(command: Sequence[str]) -> None:
    result = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    if result.returncode:
        sys.stderr.write(f"{' '.join(command)}\n{result.stdout}{result.stderr}")
        reason = next((line for line in result.stderr.splitlines() if "error" in line.lower()), "")
        raise BuildError(f"{Path(command[0]).name} failed: {reason.strip() or f'exit status {result.returncode}'}")


def compile_and_link(
    packages: Sequence[InterfacePackage], generators: Generators, compiler: Compiler, report: Report
) -> None:
    libraries = [library for library in _LIBRARIES if generators.output_folder(library.name, packages[0]).is_dir()]
    headers = [generators.output_folder(library.name, packages[0]).parent for library in libraries]
    objects: dict[tuple[str, str], list[Path]] = {}
    tasks: dict[Future[Path], tuple[str, str]] = {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for package in packages:
            for library in libraries:
                for source in _sources(generators.output_folder(library.name, package)):
                    key = (package.name, library.name if source.parent.name != package.name else source.name)
                    tasks[pool.submit(compiler.compile, source, headers, package.name)] = key
        for count, done in enumerate(as_completed(tasks), 1):
            key = tasks[done]
            objects.setdefault(key, []).append(done.result())
            report(0.95 * count / len(tasks), f"compiling {key[0]}")
    for package in packages:
        report(0.95, f"linking {package.name}")
        _link(package, libraries, objects, compiler)


def _sources(folder: Path) -> Iterator[Path]:
    """The files to compile; some include a group of sources of one kind, since kinds may share interface names."""
    yield from folder.glob("*.c")
    for kind in KINDS:
        files = sorted(path for path in (folder / kind).rglob("*") if path.suffix in (".c", ".cpp"))
        # these define constants of the same names
        separate = [path for path in files if path.stem.endswith("__description")]
        yield from separate
        grouped = [path for path in files if path not in separate]
        for start in range(0, len(grouped), _FILES_PER_UNIT):
            group = grouped[start : start + _FILES_PER_UNIT]
            source = folder / kind / f"group_{start}{group[0].suffix}"
            source.write_text("".join(f'#include "{path}"\n' for path in group), encoding="utf-8")
            yield source


def _link(
    package: InterfacePackage,
    libraries: Sequence[LibraryKind],
    objects: dict[tuple[str, str], list[Path]],
    compiler: Compiler,
) -> None:
    for library in libraries:
        names = [f"{package.name}__{name}" for name in library.dependencies]
        names += [f"{other}__{name}" for other in package.dependencies for name in (library.name, C)]
        target = package.prefix / "lib" / f"lib{package.name}__{library.name}.so"
        compiler.link(
            target,
            objects[package.name, library.name],
            [*names, *library.ros_dependencies],
            ".",
            keep_unused=library.keep_unused,
        )
    for library in libraries:
        key = (package.name, f"_{package.name}_s.ep.{library.name}.c")
        if key not in objects:
            continue
        names = [f"{package.name}__{name}" for name in (library.name, PYTHON, C)]
        module = f"{package.name}_s__{library.name}{sysconfig.get_config_var('EXT_SUFFIX')}"
        target = python_folder(package.prefix) / package.name / module
        compiler.link(
            target, objects[key], [*names, "rosidl_runtime_c", "rcutils"], "../../../../lib", keep_unused=False
        )
