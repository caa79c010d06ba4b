"""Report on a campaign as a self-contained HTML page: failures, and the commands that reproduce them."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from shlex import join
from shlex import quote as quote_word
from typing import Any, Final
from urllib.parse import quote

from emulator.campaign.journal import Journal, shown
from emulator.campaign.minimise import kind_of
from emulator.campaign.plan import Axis, Plan, Run
from emulator.campaign.work import Result, Status
from urproto.durable import write_file

_SHOWN: Final = 50  # runs of a kind of failure, and values of an axis; the Parquet file has all
_KINDS: Final = 200  # kinds of failures
_STYLE: Final = Path(__file__).with_name("static") / "report.css"


@dataclass
class _Failures:
    """Runs with the same kind of failure."""

    example: Result
    count: int = 0
    runs: list[Result] = field(default_factory=list)


@dataclass
class Summary:
    """Summary of all results, which need not all be in memory."""

    by_status: Counter[Status] = field(default_factory=Counter)
    by_value: Counter[tuple[int, int]] = field(default_factory=Counter)  # failed runs, by axis and index of its value
    kinds: dict[tuple[Status, str], _Failures] = field(default_factory=dict)
    robot_s: float = 0.0
    cpu_s: float = 0.0
    left_out: int = 0  # failed runs of further kinds

    @classmethod
    def of(cls, plan: Plan, results: Iterable[Result]) -> "Summary":
        summary = cls()
        for result in results:
            summary._add(plan, result)
        return summary

    @property
    def runs(self) -> int:
        return sum(self.by_status.values())

    @property
    def passed(self) -> int:
        return self.by_status[Status.PASSED]

    def _add(self, plan: Plan, result: Result) -> None:
        self.by_status[result.status] += 1
        self.robot_s += result.robot_s or 0.0
        self.cpu_s += result.cpu_s
        if result.status is Status.PASSED:
            return
        self.by_value.update(enumerate(plan.place(result.run)))
        kind = (result.status, kind_of(result.failure))
        if kind not in self.kinds and len(self.kinds) >= _KINDS:
            self.left_out += 1
            return
        failures = self.kinds.setdefault(kind, _Failures(result))
        failures.count += 1
        if len(failures.runs) < _SHOWN:
            failures.runs.append(result)


def write_report(target: Path, plan: Plan, journal: Journal, simpler: Mapping[int, Run]) -> Summary:
    """Write the page. simpler: simplified runs that fail in the same way, by the number of the original run."""
    summary = Summary.of(plan, journal.results())
    write_file(target, _page(plan, summary, simpler))
    return summary


def _page(plan: Plan, summary: Summary, simpler: Mapping[int, Run]) -> str:
    parts = [
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{escape(plan.name)}</title>",
        f"<style>{_STYLE.read_text()}</style>",
        f"<h1>{escape(plan.name)}</h1>",
        _totals(plan, summary),
        *_failures(plan, summary, simpler),
        "<h2>Failed runs by value</h2>" if summary.by_value else "",
        *(_axis(plan, summary, number, axis) for number, axis in enumerate(plan.axes) if len(axis) > 1),
    ]
    return "\n".join(part for part in parts if part) + "\n"


def _totals(plan: Plan, summary: Summary) -> str:
    rows = [("runs", f"{summary.runs:,} of {len(plan):,}")]
    for status in Status:
        if summary.by_status[status]:
            look = "good" if status is Status.PASSED else "bad"
            rows.append((status.value, f"<span class={look}>{summary.by_status[status]:,}</span>"))
    rows.append(("robot time", f"{summary.robot_s / 3600:,.2f} h"))
    rows.append(("processor time", f"{summary.cpu_s / 3600:,.2f} h"))
    if summary.cpu_s and summary.robot_s:
        rows.append(("robot seconds per second and core", f"{summary.robot_s / summary.cpu_s:,.0f}"))
    rows.append(("run in", f"<code>{escape(plan.folder)}</code>"))
    return "<table>" + "".join(f"<tr><th>{name}<td>{value}" for name, value in rows) + "</table>"


def _failures(plan: Plan, summary: Summary, simpler: Mapping[int, Run]) -> Iterable[str]:
    if not summary.kinds:
        yield "<p class=good>Nothing failed.</p>"
        return
    yield "<h2>Failures</h2>"
    for (status, _), failures in sorted(summary.kinds.items(), key=lambda entry: -entry[1].count):
        runs = sorted(failures.runs, key=lambda result: result.run)
        yield f"<h3 class=bad>{escape(status)}: {escape(failures.example.failure)}</h3>"
        for run in (simpler[result.run] for result in runs if result.run in simpler):
            yield f"<p>Simplest run with this failure, from run {run.number}:<br><code>{_command(plan, run)}</code>"
        names = "".join(f"<th>{escape(axis.name)}" for axis in plan.axes)
        rows = "".join(_run_row(plan, result) for result in runs)
        more = f" (the first {len(runs)} of them)" if len(runs) < failures.count else ""
        yield f"<details {'open' if failures.count <= 10 else ''}><summary>{_counted(failures.count)}{more}</summary>"
        yield f"<table><tr><th>run{names}<th>failure and replay command{rows}</table></details>"
    if summary.left_out:
        yield f"<p>{_counted(summary.left_out)} more failed in other ways; results.parquet lists them.</p>"


def _run_row(plan: Plan, result: Result) -> str:
    place = plan.place(result.run)
    cells = "".join(f"<td>{_cell(axis, index)}" for axis, index in zip(plan.axes, place, strict=True))
    command = _command(plan, plan.run(result.run))
    files = "".join(f'<br><a href="{quote(name)}">{escape(name)}</a>{_opened(name)}' for name in result.files)
    return f"<tr><td class=n>{result.run}{cells}<td>{escape(result.failure)}<br><code>{command}</code>{files}"


def _opened(name: str) -> str:
    return f" <code>ur-emulator trace {escape(quote_word(name))}</code>" if name.endswith(".journal") else ""


def _axis(plan: Plan, summary: Summary, number: int, axis: Axis) -> str:
    failed = {index: count for (other, index), count in summary.by_value.items() if other == number}
    if not failed:
        return ""
    each = len(plan) // len(axis)
    worst = sorted(failed, key=lambda index: (-failed[index], index))[:_SHOWN]
    rows = "".join(
        f"<tr><td>{_cell(axis, index)}<td class=n>{failed[index]:,} of {each:,}"
        f"<td><div class=bar><div style='width:{100 * failed[index] / each:.0f}%'></div></div>"
        for index in worst
    )
    rest = f" ({len(failed)} of {len(axis):,} values, the worst {len(worst)})" if len(failed) > len(worst) else ""
    return f"<table><tr><th>{escape(axis.name)}{rest}<th>failed<th>{rows}</table>"


def _cell(axis: Axis, index: int) -> str:
    value: Any = shown(axis, index)
    return escape(str(value)) or "&ndash;"


def _command(plan: Plan, run: Run) -> str:
    return escape(join(plan.command(run)))


def _counted(count: int) -> str:
    return "1 run" if count == 1 else f"{count:,} runs"
