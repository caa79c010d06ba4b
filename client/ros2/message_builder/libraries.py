"""Builds libraries from generated code with this machine's compiler."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future
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
from client.ros2.message_builder.rosidl import DISPATCH, PYTHON, C, Generators

_ARRAY: Final = re.compile(r"^static .*?\b(\w+)\[\]", re.MULTILINE)
"""Definition of an array in a file with the descriptions of types."""

_MODULE: Final = "module"  # a Python package's compiled module


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
        (FASTRTPS, "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw", "rosidl_runtime_c", "rcutils", "rosidl_buffer"),
    ),
    LibraryKind(INTROSPECTION, (C,), (INTROSPECTION, "rosidl_runtime_c", "rosidl_buffer")),  # the last since Lyrical
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
        # -O1 would take three times as long
        options = ["-O0", "-fPIC", "-w", "-DNDEBUG", f'-DROS_PACKAGE_NAME="{package}"']
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
        command = [self._cpp, "-shared", "-o", str(target), "-Wl,-s", f"-Wl,-soname,{target.name}", *map(str, objects)]
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


class Libraries:
    """Builds the libraries of packages whose code was generated."""

    def __init__(self, packages: Sequence[InterfacePackage], generators: Generators, compiler: Compiler) -> None:
        self._generators = generators
        self._compiler = compiler
        supports = generators.typesupports
        self._kinds = [
            kind for kind in _LIBRARIES if kind.name not in (FASTRTPS, INTROSPECTION) or kind.name in supports
        ]
        self._headers = [generators.output_folder(kind.name, packages[0]).parent for kind in self._kinds]

    def compile(self, package: InterfacePackage, pool: Executor) -> list[tuple[str, Future[Path]]]:
        """Start to compile a package. Returns the name of the library, or module, that each object belongs to."""
        return [
            (name, pool.submit(self._compiler.compile, source, self._headers, package.name))
            for kind in self._kinds
            for name, source in _units(kind.name, self._generators.output_folder(kind.name, package))
        ]

    def link(self, package: InterfacePackage, objects: Sequence[tuple[str, Path]]) -> None:
        """Link a package, after those that it refers to."""
        for kind in self._kinds:
            names = [f"{package.name}__{name}" for name in kind.dependencies]
            names += [f"{other}__{name}" for other in package.dependencies for name in (kind.name, C)]
            self._compiler.link(
                package.prefix / "lib" / f"lib{package.name}__{kind.name}.so",
                [file for name, file in objects if name == kind.name],
                [*names, *kind.ros_dependencies],
                ".",
                keep_unused=kind.keep_unused,
            )
        names = [f"{package.name}__{name}" for name in (DISPATCH, PYTHON, C)]
        self._compiler.link(
            python_folder(package.prefix)
            / package.name
            / f"{package.name}_s__{DISPATCH}{sysconfig.get_config_var('EXT_SUFFIX')}",
            [file for name, file in objects if name == _MODULE],
            [*names, "rosidl_runtime_c", "rcutils"],
            "../../../../lib",
            keep_unused=False,
        )


def _units(name: str, folder: Path) -> Iterator[tuple[str, Path]]:
    """The files to compile. One includes all sources of a library: headers, which take most of the time, are read once.

    Descriptions of types are separate, because they define constants of the same names, which are renamed here.
    """
    for module in folder.glob("*.c"):
        yield _MODULE, module
    files = [path for kind in KINDS for path in sorted((folder / kind).rglob("*.c*"))]
    descriptions = [path for path in files if path.stem.endswith("__description")]
    code = [path for path in files if path not in descriptions]
    unit = folder / f"unit{code[0].suffix}"
    unit.write_text("".join(f'#include "{path}"\n' for path in code), encoding="utf-8")
    yield name, unit
    if descriptions:
        lines = []
        for count, path in enumerate(descriptions):
            constants = dict.fromkeys(_ARRAY.findall(path.read_text(encoding="utf-8")))
            lines += [f"#undef {constant}\n#define {constant} {constant}_{count}\n" for constant in constants]
            lines.append(f'#include "{path}"\n')
        unit = folder / "descriptions.c"
        unit.write_text("".join(lines), encoding="utf-8")
        yield name, unit
