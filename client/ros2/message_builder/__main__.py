"""The process that builds; `client.ros2.message_builder` says what it reads and writes."""

import json
import os
import sys
from pathlib import Path
from typing import Final

from client.ros2.message_builder.libraries import Compiler, compile_and_link
from client.ros2.message_builder.packages import (
    BuildError,
    Installation,
    Plan,
    install_python,
    packages_of,
    register,
)
from client.ros2.message_builder.rosidl import PYTHON, Generators, Report

_GENERATED: Final = 0.4  # of the whole work; measured


def build(plan: Plan, report: Report) -> None:
    """Raises BuildError."""
    report(0.0, "reading definitions")
    installation = Installation([Path(prefix) for prefix in plan.prefixes])
    compiler = Compiler(installation, Path(plan.scratch))
    packages = packages_of(plan, installation)
    generators = Generators(installation, Path(plan.scratch), packages)
    for package in packages:
        generators.describe(package)
    generators.generate(lambda part, what: report(part * _GENERATED, what))
    compile_and_link(
        packages, generators, compiler, lambda part, what: report(_GENERATED + part * (1 - _GENERATED), what)
    )
    for package in packages:
        install_python(package, generators.output(PYTHON, package))
        register(package)


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
    sys.path.pop(0)  # the folder of this file: its modules are found by their full names only
    main()
