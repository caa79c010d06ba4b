"""How findings are reported: as text, JSON, SARIF 2.1.0 or annotations of GitHub."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

from urproto.text import readable
from urproto.versions import PolyscopeVersion
from urscript.check.checking import Finding
from urscript.check.rules import RULES

_LEVELS: Final = {True: "error", False: "warning"}
_SARIF: Final = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
_IN_MESSAGES: Final = str.maketrans({"%": "%25", "\r": "%0D", "\n": "%0A"})
_IN_PROPERTIES: Final = str.maketrans({"%": "%25", "\r": "%0D", "\n": "%0A", ":": "%3A", ",": "%2C"})

Report: TypeAlias = Mapping[str, tuple[list[Finding], list[PolyscopeVersion]]]
"""The findings of each file, which may be none, and the versions it was checked for."""


def as_text(report: Report) -> Iterator[str]:
    """The findings with the lines they are on; of several versions, a table of which finding holds for which."""
    for file, (found, checked) in report.items():
        for finding in found:
            yield from _lines(finding)
        if checked and not any(finding.is_error for finding in found):
            some = f"no errors, {len(found)} warning{'s' if len(found) > 1 else ''}"
            shown = ", ".join(map(str, checked))
            yield f"{file}: {some if found else 'no problems found'} for PolyScope {shown}"
    versions = list(dict.fromkeys(version for _, checked in report.values() for version in checked))
    if len(versions) > 1:
        yield from _table(report, versions)


def _all(report: Report) -> Iterator[Finding]:
    return (finding for found, _ in report.values() for finding in found)


def _lines(finding: Finding) -> Iterator[str]:
    rank = "" if finding.is_error else "warning: "
    yield f"{finding.file}:{finding.line}:{finding.column}: {rank}{finding.message} [{finding.code}]"
    if not finding.text:
        return
    indent = "".join("\t" if char == "\t" else " " for char in finding.text[: finding.column - 1])
    yield f"  {finding.line} | {finding.text.rstrip(chr(13))}"
    yield f"  {' ' * len(str(finding.line))} | {indent}^"


def _table(report: Report, versions: Sequence[PolyscopeVersion]) -> Iterator[str]:
    rows = [(f"{f.file}:{f.line}:{f.column} {f.code}", f.versions) for f in _all(report)]
    width = max((len(place) for place, _ in rows), default=0)
    if rows:
        yield ""
        yield f"{'finding':<{width}}  {'  '.join(map(str, versions))}"
    for place, held in rows:
        cells = "  ".join(f"{'x' if version in held else '-':<{len(str(version))}}" for version in versions)
        yield f"{place:<{width}}  {cells}".rstrip()


def as_json(report: Report) -> Iterator[str]:
    """A list of findings, each with the versions for which it holds."""
    yield json.dumps([_as_dict(finding) for finding in _all(report)], indent=1)


def _as_dict(finding: Finding) -> dict[str, Any]:
    return {
        "file": readable(finding.file),
        "line": finding.line,
        "column": finding.column,
        "code": finding.code,
        "rule": RULES[finding.code].name,
        "severity": _LEVELS[finding.is_error],
        "message": readable(finding.message),
        "versions": list(map(str, finding.versions)),
    }


def as_github(report: Report) -> Iterator[str]:
    """Workflow commands that annotate a pull request."""
    for finding in _all(report):
        title = f"{finding.code} {RULES[finding.code].name}".translate(_IN_PROPERTIES)
        place = f"file={finding.file.translate(_IN_PROPERTIES)},line={finding.line},col={finding.column}"
        message = finding.message.translate(_IN_MESSAGES)
        yield f"::{_LEVELS[finding.is_error]} {place},title={title}::{message}"


def as_sarif(report: Report) -> Iterator[str]:
    """A log of SARIF 2.1.0 (OASIS) with one run, as code scanning services read it."""
    order = list(RULES)
    rules = [
        {
            "id": rule.code,
            "name": rule.name,
            "shortDescription": {"text": rule.summary},
            "defaultConfiguration": {"level": _LEVELS[rule.error]},
        }
        for rule in RULES.values()
    ]
    results = [
        {
            "ruleId": finding.code,
            "ruleIndex": order.index(finding.code),
            "level": _LEVELS[finding.is_error],
            "message": {"text": readable(finding.message)},
            "locations": [
                {
                    "physicalLocation": {
                        "artifactLocation": {"uri": _uri(finding.file)},
                        "region": {"startLine": finding.line, "startColumn": finding.column},
                    }
                }
            ],
            "properties": {"versions": list(map(str, finding.versions))},
        }
        for finding in _all(report)
    ]
    driver = {"name": "urscript check", "rules": rules}
    run = {"tool": {"driver": driver}, "results": results, "columnKind": "unicodeCodePoints"}
    yield json.dumps({"$schema": _SARIF, "version": "2.1.0", "runs": [run]}, indent=1)


def _uri(file: str) -> str:
    from urllib.parse import quote

    return Path(file).as_uri() if Path(file).is_absolute() else quote(Path(readable(file)).as_posix())


FORMATS: Final[dict[str, Callable[[Report], Iterable[str]]]] = {
    "text": as_text,
    "json": as_json,
    "sarif": as_sarif,
    "github": as_github,
}
