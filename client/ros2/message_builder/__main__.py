"""The build process; `client.ros2.message_builder` describes its input and output."""

import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from client.ros2.message_builder.libraries import Compiler, Libraries
from client.ros2.message_builder.packages import (
    BuildError,
    BuildPlan,
    InterfacePackage,
    RosInstallation,
    install_python,
    is_complete,
    packages_of,
    record,
    register,
)
from client.ros2.message_builder.rosidl import PYTHON, Generators


class Build:
    """A build of the packages of a plan that are not complete yet.

    report: called with the share done, 0 to 1, and the current activity.
    """

    def __init__(self, plan: BuildPlan, report: Callable[[float, str], None]) -> None:
        self._report = report
        installation = RosInstallation([Path(prefix) for prefix in plan.prefixes])
        packages = packages_of(plan, installation)
        self._packages = [package for package in packages if not is_complete(package.prefix, package.name)]
        self._generators = Generators(installation, Path(plan.scratch), packages)
        self._libraries = Libraries(packages, self._generators, Compiler(installation, Path(plan.scratch)))
        self._done = sum(len(package.files) for package in packages if package not in self._packages)
        self._total = sum(len(package.files) for package in packages)

    def run(self) -> None:
        """Generate code in this thread, which is pure Python, while compilers work on earlier packages.

        Raises BuildError.
        """
        with ThreadPoolExecutor(os.cpu_count()) as compilers, ThreadPoolExecutor(1) as finisher:
            finished = []
            for package in self._packages:
                self._generators.write_definitions(package)
                self._generators.generate(package)
                objects = self._libraries.compile(package, compilers)
                finished.append(finisher.submit(self._finish, package, objects))
            for package_finished in finished:
                package_finished.result()

    def _finish(self, package: InterfacePackage, objects: Sequence[tuple[str, Future[Path]]]) -> None:
        for count, (_, compiled) in enumerate(objects):
            share = (self._done + len(package.files) * count / len(objects)) / self._total
            self._report(share, f"compiling {package.name}")
            compiled.result()
        self._libraries.link(package, [(name, compiled.result()) for name, compiled in objects])
        install_python(package, self._generators.output_folder(PYTHON, package))
        register(package)
        record(package.prefix, package.name)
        self._done += len(package.files)


def main() -> None:
    def report(share: float, activity: str) -> None:
        try:
            stdout.write(f"{share:.3f} {activity}\n")
            stdout.flush()
        except BrokenPipeError:  # the process that started this one was killed
            if sys.platform != "win32":
                os.killpg(0, signal.SIGKILL)

    # generators print the names of files to standard output
    stdout = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        report(0.0, "reading definitions")
        Build(BuildPlan(**json.load(sys.stdin)), report).run()
    except BuildError as error:
        print(f"error {error}", flush=True, file=stdout)
        sys.exit(1)


if __name__ == "__main__":
    sys.path.pop(0)  # the folder of this file: its modules are imported by their full names only
    main()
