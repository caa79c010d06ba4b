"""The options of ``urscript check``, and its exit status."""

import re
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Container, Iterator, Sequence
from pathlib import Path
from typing import Final

from urproto.entry import SUCCESS, TROUBLE, usage_error
from urproto.facts import known_releases
from urproto.versions import DEFAULT_VERSION, PolyscopeVersion, Series
from urscript.check.checking import Finding, findings
from urscript.check.formats import FORMATS, Report
from urscript.check.project import Project, project_of
from urscript.check.rules.variables import UNUSED_INCLUDE
from urscript.check.sources import SourceError, content, files_in, has_saved_script, sources_in

HELP: Final = "check programs and report all errors and warnings"

_STDIN: Final = "-"
_WORD: Final = re.compile(r"\w+")


def add_arguments(parser: ArgumentParser) -> None:
    """Add the options of the command."""
    parser.add_argument(
        "files",
        nargs="+",
        metavar="FILE",
        help="script, program tree (.urp), Python or C++ file with programs in string literals, or a folder of scripts "
        "and program trees; - reads a script from standard input",
    )
    parser.add_argument("--model", help="arm whose series selects the version, such as ur5e")
    parser.add_argument("--polyscope", help="PolyScope version to check for, or several: 3.15,5.12,5.25")
    parser.add_argument("--format", choices=list(FORMATS), default="text", help="how findings are reported")
    parser.add_argument("--strict", action="store_true", help="warnings count as errors in the exit status")
    parser.add_argument("--isolated", action="store_true", help="ignore project files")


def run(options: Namespace) -> int:
    """Check the files; the exit status is 0, 1 for findings that count, or 2 for wrong usage."""
    report: dict[str, tuple[list[Finding], list[PolyscopeVersion]]] = {}
    status = SUCCESS
    words: dict[Project, set[str]] = {}
    try:
        for name in options.files:
            for file in _files(name):
                try:
                    project = Project() if options.isolated else project_of(Path(file).absolute().parent)
                    versions = chosen_versions(options, project)
                    in_folder = file != name
                    report[_shown(file)] = _check(file, project, versions, words, in_folder), versions
                except SourceError as error:
                    status = usage_error("urscript", error)
            for project in {project for project in words if project.path and Path(name).is_dir()}:
                report |= _unused(project, words[project], Path(name))
    except ValueError as error:
        return usage_error("urscript", error)
    for line in FORMATS[options.format](report):
        print(line)
    failed = any(found.is_error or options.strict for all_, _ in report.values() for found in all_)
    return max(status, TROUBLE if failed else SUCCESS)


def _check(
    file: str, project: Project, versions: Sequence[PolyscopeVersion], words: dict[Project, set[str]], in_folder: bool
) -> list[Finding]:
    data = content(_shown(file), sys.stdin.buffer) if file == _STDIN else None
    sources = {version: sources_in(_shown(file), data, project, version) for version in versions}
    for source in sources[versions[0]] if project.sources else ():
        words.setdefault(project, set()).update(_WORD.findall(source.script.text))
    return findings(sources, project, only_stale=in_folder and has_saved_script(Path(file)))


def _files(name: str) -> Iterator[str]:
    return map(str, files_in(Path(name))) if name != _STDIN and Path(name).is_dir() else iter([name])


def _shown(file: str) -> str:
    return "<stdin>" if file == _STDIN else file


def chosen_versions(options: Namespace, project: Project) -> list[PolyscopeVersion]:
    """The versions that the options select, or else the project file, or else the emulator's default.

    Raises ValueError.
    """
    texts = options.polyscope.split(",") if options.polyscope else project.versions if not options.model else ()
    models = [options.model.lower()] if options.model else project.models
    if not texts and not models:
        return [DEFAULT_VERSION[Series.CB3]]
    if not models and all(PolyscopeVersion.parse(text) in _usual_versions() for text in texts):
        return list(dict.fromkeys(PolyscopeVersion.parse(text) for text in texts))
    from urproto.robots import choose_version, default_model, load_model  # here, because it takes as long as a check

    arms = [load_model(model) for model in models]
    if not texts:
        return list(dict.fromkeys(choose_version(None, arm) for arm in arms))
    for text in texts:
        matching = [arm for arm in arms if arm.series is PolyscopeVersion.parse(text).series]
        choose_version(text.strip(), (matching or arms or [load_model(default_model(text.strip()))])[0])
    return list(dict.fromkeys(PolyscopeVersion.parse(text) for text in texts))


def _usual_versions() -> Container[PolyscopeVersion]:
    """Versions that need no closer look."""
    return {PolyscopeVersion(release.major, release.minor) for release in known_releases()}


def _unused(project: Project, words: set[str], folder: Path) -> Report:
    """The findings in a project file whose whole folder was checked: what no program uses."""
    assert project.path is not None
    if not project.selects(UNUSED_INCLUDE) or not project.path.resolve().is_relative_to(folder.resolve()):
        return {}
    found = []
    here, path = Path.cwd(), project.path.resolve()
    shown = str(path.relative_to(here) if path.is_relative_to(here) else path)
    lines = project.path.read_text(encoding="utf-8").split("\n")
    for text, known in project.sources.items():
        if words.isdisjoint([*known.functions, *known.variables]) and (known.functions or known.variables):
            line = next((number for number, row in enumerate(lines, 1) if text in row), 1)
            message = f"no program uses what '{text}' defines"
            found.append(Finding(shown, line, 1, UNUSED_INCLUDE, message, lines[line - 1]))
    return {shown: (found, [])} if found else {}
