"""What an exploration has found: in words, as a test that can be kept, as a journal, and for CI systems."""

from collections.abc import Mapping, Sequence
from os.path import relpath
from pathlib import Path
from pprint import pformat
from typing import Final
from xml.etree import ElementTree

from emulator.explore.choices import Decision, Schedule
from emulator.explore.plan import Plan, read_plan
from emulator.explore.run import Run, Trail
from emulator.explore.search import Found, Runner, explored
from emulator.realtime import usable_cores
from urproto.durable import write_file
from urproto.text import readable

_TEST: Final = '''"""Found by ``ur-emulator explore {plan}``: {name} is broken when

{story}
"""

from pathlib import Path

from emulator.explore.answer import broken_by

PLAN = Path(__file__).parent / "{path}"
SCHEDULE = {schedule}


def test_{identifier}():
    assert broken_by(PLAN, SCHEDULE) == {{}}
'''


def story(plan: Plan, trail: Trail) -> list[str]:
    """The decisions of a run in words, a line for each, and how it ended."""
    lines = []
    for decision in trail.schedule:
        begins_s = decision.period * plan.period_s
        for delay_s, kind, values in plan.choices[decision.choice].actions(dict(decision.values)):
            words = kind.words(values, decision.period + round(delay_s / plan.period_s))
            lines.append(f"at {begins_s + delay_s:.3f} s: {decision.choice}: {words}")
    return [*lines, *(f"{name}: {why}" for name, why in trail.broken.items())]


def broken_by(path: Path, schedule: Sequence[tuple[int, str, Mapping[str, object]]]) -> dict[str, str]:
    """The properties of a plan that a schedule breaks, with the reasons. Raises ConfigError, PlanError.

    schedule: decisions as in the tests that an exploration writes: control period, name of the choice, its values.
    """
    made = tuple(Decision(period, choice, tuple(values.items())) for period, choice, values in schedule)
    return Run(read_plan(path)).finish(made).broken


def write_found(plan_file: Path, plan: Plan, found: Found, folder: Path) -> Path:
    """Write the journal of the run and a test of it; return the journal's path. Raises OSError."""
    folder.mkdir(parents=True, exist_ok=True)
    identifier = "".join(letter if letter.isalnum() else "_" for letter in found.property.lower())
    run = Run(plan, checked=True)
    run.finish(found.trail.schedule)
    journal = folder / f"{identifier}.journal"
    write_file(journal, run.journal)
    text = _TEST.format(
        plan=plan_file.name,
        path=Path(relpath(plan_file, folder)).as_posix(),
        name=found.property,
        story="\n".join(story(plan, found.trail)),
        schedule=_as_code(found.trail.schedule),
        identifier=identifier,
    )
    write_file(folder / f"test_{identifier}.py", text)
    return journal


def _as_code(schedule: Schedule) -> str:
    return pformat([(one.period, one.choice, dict(one.values)) for one in schedule], width=110, sort_dicts=False)


def junit(plan: Plan, answers: Mapping[str, Found], runs: int) -> bytes:
    suite = ElementTree.Element(
        "testsuite",
        {"name": plan.name, "tests": str(len(plan.properties)), "failures": str(len(answers)), "errors": "0"},
    )
    for one in plan.properties:
        case = ElementTree.SubElement(suite, "testcase", {"classname": plan.name, "name": one.name})
        if (found := answers.get(one.name)) is not None:
            lines = story(plan, found.trail)
            ElementTree.SubElement(case, "failure", {"message": readable(lines[-1])}).text = readable("\n".join(lines))
    ElementTree.SubElement(suite, "system-out").text = f"{runs} runs"
    text: bytes = ElementTree.tostring(suite, encoding="utf-8", xml_declaration=True)
    return text


def explanation(path: Path, runs: int, seed: int) -> str:
    """Explore a plan; what breaks its properties, in words, empty if nothing does. Raises ConfigError, PlanError."""
    plan = read_plan(path)
    with Runner(plan, usable_cores()) as runner:
        found, _ = explored(plan, runner, seed, lambda: runner.runs >= runs)
    told = ([f"{one.property} is broken:", *story(plan, one.trail)] for one in found.values())
    return "\n".join("\n  ".join(lines) for lines in told)
