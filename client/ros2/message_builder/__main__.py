"""The build process; `client.ros2.message_builder` describes its input and output."""

import json
import os
import sys
from pathlib import Path
from typing import Final

from client.ros2.message_builder.libraries import Compiler, compile_and_link
from client.ros2.message_builder.packages import (
    BuildError,
    BuildPlan,
    RosInstallation,
    install_python,
    packages_of,
    register,
)
from client.ros2.message_builder.rosidl import PYTHON, Generators, Report

_GENERATION_SHARE: Final = 0.4  # of the whole build; measured


def build(plan: BuildPlan, report: Report) -> None:
    """Build all packages of a plan. Raises BuildError."""
    report(0.0, "reading definitions")
    installation = RosInstallation([Path(prefix) for prefix in plan.prefixes])
    compiler = Compiler(installation, Path(plan.scratch))
    packages = packages_of(plan, installation)
    generators = Generators(installation, Path(plan.scratch), packages)
    for package in packages:
        generators.write_definitions(package)
    generators.generate(lambda share, activity: report(share * _GENERATION_SHARE, activity))
    compile_and_link(
        packages,
        generators,
        compiler,
        lambda share, activity: report(_GENERATION_SHARE + share * (1 - _GENERATION_SHARE), activity),
    )
    for package in packages:
        install_python(package, generators.output_folder(PYTHON, package))
        register(package)


def main() -> None:
    def report(share: float, activity: str) -> None:
        print(f"{share:.3f} {activity}", flush=True, file=stdout)

    # generators print the names of files to standard output
    stdout = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        build(BuildPlan(**json.load(sys.stdin)), report)
    except BuildError as error:
        print(f"error {error}", flush=True, file=stdout)
        sys.exit(1)


if __name__ == "__main__":
    sys.path.pop(0)  # the folder of this file: its modules are imported by their full names only
    main()
