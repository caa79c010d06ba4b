"""Implements ``urscript test``."""

import multiprocessing
import os
from argparse import Namespace
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from emulator.scripttest.coverage import coverage_table, lcov, merged
from emulator.scripttest.profile import profile_table, speedscope
from emulator.scripttest.runner import Observation, Result, Status, run_options, run_test
from urproto.durable import write_file
from urproto.entry import SUCCESS, TROUBLE, usage_error
from urproto.text import readable
from urscript.errors import ScriptError
from urscript.scripttest.suite import SuiteError, Test, find_files, tests_of

_CONTROL = {code: None for code in range(32) if chr(code) not in "\t\n\r"}  # not allowed in XML
_SHOWN = 20  # lines of a report
_ELEMENTS = {Status.FAILED: "failure", Status.ERROR: "error"}


def run(options: Namespace) -> int:
    """Find and run the tests; return the exit status."""
    try:
        files = list(find_files(options.paths))
    except SuiteError as error:
        return usage_error("urscript test", error)
    tests, results = _collect(files, options.keyword)
    defaults = {name: value for name in ("model", "polyscope") if (value := getattr(options, name))}
    observation = Observation(bool(options.coverage or options.lcov), bool(options.profile))
    for result in results:
        print(result_line(result), flush=True)
    for result in _run_all(tests, defaults, observation, options.processes):
        print(result_line(result), flush=True)
        results.append(result)
    wrong = [result for result in results if result.status is not Status.PASSED]
    for result in wrong:
        print(f"\n{failure_text(result)}", end="")
    try:
        _write_reports(options, results)
    except OSError as error:
        return usage_error("urscript test", f"{error.filename}: {error.strerror}")
    print(summary(results))
    return TROUBLE if wrong or not results else SUCCESS


def _collect(files: Sequence[Path], keyword: str) -> tuple[list[Test], list[Result]]:
    """The tests whose title contains the keyword, and a result for each file that could not be read."""
    tests, unreadable = [], []
    for file in files:
        try:
            found = [test for test in tests_of(file) if keyword in test.title]
            for test in found:
                run_options(test.settings, {})
            tests += found
        except ScriptError as error:
            unreadable.append(Result(str(file), Status.ERROR, error.render(str(file))))
        except (SuiteError, OSError) as error:
            unreadable.append(Result(str(file), Status.ERROR, str(error)))
    return tests, unreadable


def _run_all(
    tests: Sequence[Test], defaults: Mapping[str, Any], observation: Observation, processes: int
) -> Iterator[Result]:
    """The results in the order of the tests. processes: 0 for one per processor."""
    run_one = partial(run_test, defaults=defaults, observation=observation)
    processes = min(processes or os.cpu_count() or 1, len(tests))
    if processes <= 1:
        yield from map(run_one, tests)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(run_one, tests)


def _write_reports(options: Namespace, results: Sequence[Result]) -> None:
    """Write the files and print the tables that the options name. Raises OSError."""
    if options.junit:
        write_file(options.junit, junit(results))
    if options.coverage or options.lcov:
        coverage = merged(result.coverage for result in results)
        print(f"\n{coverage_table(coverage)}\n")
        if options.lcov:
            write_file(options.lcov, lcov(coverage))
    if options.profile:
        threads = {f"{result.title} {name}": one for result in results for name, one in result.profile.items()}
        print(f"\n{profile_table(threads)}\n")
        write_file(options.profile, speedscope(threads))


def result_line(result: Result) -> str:
    return f"{result.title} {result.status.upper()} ({result.robot_s:.2f} s of robot time)"


def failure_text(result: Result) -> str:
    """The reason for a failure, and what the program reported."""
    reported = "\n".join(["..."] * (len(result.lines) > _SHOWN) + result.lines[-_SHOWN:])
    return f"{result.title}\n{result.failure}\n" + (f"--- reported\n{reported}\n" if reported else "")


def summary(results: Sequence[Result]) -> str:
    """The numbers of results, and the time they took."""
    counts = {status: sum(result.status is status for result in results) for status in Status}
    parts = [f"{count} {status}" for status, count in counts.items() if count]
    robot_s = sum(result.robot_s for result in results)
    return f"{', '.join(parts) or 'no tests found'} ({robot_s:.1f} s of robot time)"


def junit(results: Sequence[Result]) -> bytes:
    failures, errors = (sum(result.status is status for result in results) for status in _ELEMENTS)
    counts = {"tests": str(len(results)), "failures": str(failures), "errors": str(errors)}
    total_s = f"{sum(result.wall_s for result in results):.3f}"
    suites = ElementTree.Element("testsuites")
    suite = ElementTree.SubElement(suites, "testsuite", {"name": "urscript", **counts, "time": total_s})
    for result in results:
        file, _, name = result.title.partition("::")
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": file, "name": name or file, "time": f"{result.wall_s:.3f}"}
        )
        properties = ElementTree.SubElement(case, "properties")
        ElementTree.SubElement(properties, "property", {"name": "robot_s", "value": f"{result.robot_s:.3f}"})
        if element := _ELEMENTS.get(result.status):
            problem = ElementTree.SubElement(case, element, {"message": _clean(result.summary)})
            problem.text = _clean(result.failure)
        if result.lines:
            ElementTree.SubElement(case, "system-out").text = _clean("\n".join(result.lines))
    text: bytes = ElementTree.tostring(suites, encoding="utf-8", xml_declaration=True)
    return text


def _clean(text: str) -> str:
    return readable(text).translate(_CONTROL)
