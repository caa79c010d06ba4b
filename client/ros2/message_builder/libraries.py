"""Libraries of what the generators have made, by the compiler of the machine."""

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
    Installation,
    Package,
    python_folder,
)
from client.ros2.message_builder.rosidl import DISPATCH, PYTHON, C, Generators, Report

_AT_ONCE: Final = 12  # files compiled as one: most of the time goes into headers, which are then read once


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
    Library(C, (), ("rosidl_runtime_c", "rcutils")),
    Library(
        FASTRTPS,
        (C,),
        (FASTRTPS, "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw", "rosidl_runtime_c", "rcutils"),
    ),
    Library(INTROSPECTION, (C,), (INTROSPECTION, "rosidl_runtime_c")),
    Library(DISPATCH, (C, FASTRTPS, INTROSPECTION), (DISPATCH, "rosidl_runtime_c"), loads=True),
    Library(PYTHON, (C, DISPATCH), ("rosidl_runtime_c",)),
)


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


def compile_and_link(packages: Sequence[Package], generators: Generators, compiler: Compiler, report: Report) -> None:
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
        names += [f"{other}__{name}" for other in package.uses for name in (library.name, C)]
        target = package.prefix / "lib" / f"lib{package.name}__{library.name}.so"
        compiler.link(target, objects[package.name, library.name], [*names, *library.ros], ".", loads=library.loads)
    for library in libraries:
        part = (package.name, f"_{package.name}_s.ep.{library.name}.c")
        if part not in objects:
            continue
        names = [f"{package.name}__{name}" for name in (library.name, PYTHON, C)]
        module = f"{package.name}_s__{library.name}{sysconfig.get_config_var('EXT_SUFFIX')}"
        target = python_folder(package.prefix) / package.name / module
        compiler.link(target, objects[part], [*names, "rosidl_runtime_c", "rcutils"], "../../../../lib", loads=False)
