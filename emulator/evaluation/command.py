"""``ur-emulator evaluate``: how well a policy solves a task."""

import time
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from emulator.config import ConfigError
from emulator.logs import LogLevel, log_to_stderr
from emulator.options import errors_in_one_line
from emulator.realtime import usable_cores
from urproto.commandline import application
from urproto.durable import write_file
from urproto.extras import how_to_install

if TYPE_CHECKING:
    from emulator.evaluation.episodes import Episode

_BELOW: Final = 1
_BETWEEN_STEPS: Final = 101  # of a range of latencies
_TOLD_S: Final = 10.0  # between two lines of progress

app = application(completion=False)


@app.command()
def _evaluate(
    task: Annotated[
        str,
        typer.Argument(
            help="reach, push, pick_and_place, peg_in_hole, a folder with a task (docs/evaluation.md), or "
            "FILE.py:CLASS, an environment."
        ),
    ],
    *,
    policy: Annotated[
        str, typer.Option(help="FILE.py:NAME or MODULE:NAME, called with the environment; or random, for any actions.")
    ],
    episodes: Annotated[int, typer.Option(min=1, max=1_000_000, help="Number of episodes at most.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the others follow.")] = 0,
    steps: Annotated[int, typer.Option(min=0, help="Steps of an episode (default: those of the task).")] = 0,
    option: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE", help="Option of the environment: model=ur3e, control_mode=joint_position."),
    ] = None,
    latency: Annotated[
        str | None,
        typer.Option(
            metavar="SECONDS", help="Time that the policy takes: 0.05, 0.02..0.08, or a file of measured values."
        ),
    ] = None,
    sprt: Annotated[
        str | None,
        typer.Option(metavar="LOW,HIGH", help="Stop when it is clear which of these two success rates it is."),
    ] = None,
    at_least: Annotated[
        float | None, typer.Option(min=0.0, max=1.0, help="Success rate below which the exit status is 1.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of processes (default: one per core); the report is the same.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for report.json, and for what failed.")] = None,
    keep: Annotated[int, typer.Option(min=0, help="Failed episodes to keep, as journal and film, with --out.")] = 5,
) -> None:
    """Evaluate a policy in episodes of a task, in virtual time: success, with its confidence interval, and motion."""
    log_to_stderr(LogLevel.ERROR)
    with errors_in_one_line():
        if find_spec("gymnasium") is None:
            raise ConfigError(f"evaluations need Gymnasium: {how_to_install('learning')}")
        from emulator.evaluation.episodes import LATENCY, EvaluationError, Setting
        from emulator.evaluation.evaluate import evaluate

        options = dict(map(_option, option or []))
        if latency is not None:
            options[LATENCY] = _latency(latency)
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)
        setting = Setting(task, policy, tuple(sorted(options.items())), latency or "", steps)
        try:
            report = evaluate(
                setting, range(seed, seed + episodes), workers or usable_cores(), _rates(sprt), _Progress(episodes)
            )
            if out is not None:
                write_file(out / "report.json", report.json())
                _keep([one for one in report.episodes if not one.success][:keep], setting, out)
        except EvaluationError as error:
            raise ConfigError(str(error)) from error
    typer.echo(report.text())
    if (at_least is not None and report.rate < at_least) or (sprt and report.decision == _rates(sprt)[0]):  # type: ignore[index]
        raise typer.Exit(_BELOW)


class _Progress:
    """Says now and then how many episodes are over."""

    def __init__(self, total: int) -> None:
        self._total, self._done, self._told_s = total, 0, time.monotonic()

    def __call__(self, episode: "Episode") -> None:
        self._done += 1
        if time.monotonic() - self._told_s >= _TOLD_S:
            self._told_s = time.monotonic()
            typer.echo(f"{self._done} of {self._total} episodes", err=True)


def _keep(failed: "Sequence[Episode]", setting: Any, folder: Path) -> None:
    from emulator.evaluation.episodes import keep_failure

    for episode in failed:
        kept = keep_failure(setting, episode, folder / "failures")
        if not kept:
            typer.echo(
                f"episode {episode.seed} went otherwise when it was played again: the policy does more than its "
                "observations and reset(seed) determine",
                err=True,
            )
        for path in kept:
            typer.echo(f"kept {path}", err=True)


def _option(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not equals:
        raise ConfigError(f"--option must be NAME=VALUE, not {text!r}")
    return name, value if name in ("model", "polyscope") else _plain(value)


def _plain(value: str) -> Any:
    """A number, a truth value, a list of words, or text."""
    if value in ("true", "false"):
        return value == "true"
    try:
        return int(value) if value.lstrip("-").isdigit() else float(value)
    except ValueError:
        return tuple(value.split(",")) if "," in value else value


def _latency(text: str) -> float | tuple[float, ...]:
    try:
        if ".." in text and not Path(text).is_file():
            low, high = map(float, text.split("..", 1))
            return tuple(low + (high - low) * i / (_BETWEEN_STEPS - 1) for i in range(_BETWEEN_STEPS))
        return tuple(map(float, Path(text).read_text().split())) if Path(text).is_file() else float(text)
    except ValueError:
        raise ConfigError(
            f"--latency must be seconds (0.05), a range (0.02..0.08), or a file of numbers, not {text!r}"
        ) from None


def _rates(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = map(float, text.split(","))
        if 0.0 < low < high < 1.0:
            return low, high
    except ValueError:
        pass
    raise ConfigError(f"--sprt must be two rates between 0 and 1, the lower one first, such as 0.7,0.9; not {text!r}")
