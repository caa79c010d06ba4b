"""Results of tests as text, and as the XML of JUnit that CI systems read."""

from collections.abc import Sequence
from xml.etree import ElementTree

from emulator.scripttest.runner import Result, Status
from urproto.text import readable

_CONTROL = {code: None for code in range(32) if chr(code) not in "\t\n\r"}  # not allowed in XML
_SHOWN = 20  # lines of a report
_ELEMENTS = {Status.FAILED: "failure", Status.ERROR: "error"}


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
