"""What an evaluation found, as text and as JSON: without times of this machine, so that it is the same each time.

How sure a success rate is: the interval of Clopper and Pearson, and Wald's sequential test.
"""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from math import exp, lgamma, log, log1p
from statistics import fmean, median
from typing import Any, Final

from emulator.evaluation.episodes import LATENCY, Episode, Setting

_MEASURES: Final = (
    ("duration_s", "robot time", "s"),
    ("steps", "steps", ""),
    ("reward", "reward", ""),
    ("path_m", "path of the TCP", "m"),
    ("jerk_rad_s3", "jerk of the joints", "rad/s3"),
    ("force_N", "largest force", "N"),
)
_ROW: Final = "{:28}{:>10}{:>10}{:>10}"
CONFIDENCE: Final = 0.95
_ERROR: Final = 0.05  # of the sequential test, both ways
_BISECTIONS: Final = 60  # to the last bit of a float, about
_NEGLIGIBLE: Final = 1e-17


@dataclass(frozen=True)
class Report:
    """Results of an evaluation, in the order of the seeds. between: the rates of the sequential test, if it was asked
    for."""

    setting: Setting
    episodes: Sequence[Episode]
    between: tuple[float, float] | None = None

    @property
    def successes(self) -> int:
        return sum(episode.success for episode in self.episodes)

    @property
    def rate(self) -> float:
        """The share of episodes that reached the goal."""
        return self.successes / len(self.episodes)

    @property
    def decision(self) -> float | None:
        """The rate for which the sequential test decided; None if it did not, or was not asked for."""
        if self.between is None:
            return None
        return decided([episode.success for episode in self.episodes], *self.between)[1]

    def text(self) -> str:
        """The report for a terminal."""
        low, high = success_interval(self.successes, len(self.episodes))
        lines = [
            f"{self.setting.task}: {self.successes} of {len(self.episodes)} episodes reached the goal: "
            f"{self.rate:.1%} ({CONFIDENCE:.0%} confidence: {low:.1%} to {high:.1%})"
        ]
        if self.between is not None:
            rates = "{:g} or {:g}".format(*self.between)
            found = "not decided" if self.decision is None else f"{self.decision:g}"
            lines.append(f"success rate of {rates}: {found}")
        lines.append(_ROW.format("", "median", "least", "most"))
        for name, title, unit in _MEASURES:
            values = [getattr(episode, name) for episode in self.episodes]
            shown = [f"{value:.4g}" for value in (median(values), min(values), max(values))]
            lines.append(_ROW.format(f"{title} [{unit}]" if unit else title, *shown))
        if late := sum(episode.late for episode in self.episodes):
            lines.append(f"{late} of {sum(episode.steps for episode in self.episodes)} actions were late")
        lines += [f"{count} ended early: {why}" for why, count in self._stops()]
        if missed := [episode.seed for episode in self.episodes if not episode.success]:
            lines.append(f"seeds of episodes that did not reach it: {_listed(missed)}")
        return "\n".join(lines)

    def json(self) -> str:
        """The report for programs: with each episode."""
        low, high = success_interval(self.successes, len(self.episodes))
        means = {name: fmean(getattr(episode, name) for episode in self.episodes) for name, *_ in _MEASURES}
        content: dict[str, Any] = {
            "task": self.setting.task,
            "policy": self.setting.policy,
            "options": {name: value for name, value in self.setting.options if name != LATENCY},
            "latency": self.setting.latency,
            "episodes": len(self.episodes),
            "success": {
                "count": self.successes,
                "rate": self.rate,
                "low": low,
                "high": high,
                "confidence": CONFIDENCE,
            },
            "mean": means,
            "late": sum(episode.late for episode in self.episodes),
            "stops": dict(self._stops()),
        }
        if self.between is not None:
            content["sequential_test"] = {"between": self.between, "decision": self.decision}
        content["each"] = [asdict(episode) for episode in self.episodes]
        return json.dumps(content, indent=1) + "\n"

    def _stops(self) -> list[tuple[str, int]]:
        return Counter(episode.stopped for episode in self.episodes if episode.stopped).most_common()


def _listed(numbers: Iterable[int], most: int = 20) -> str:
    every = [*numbers]
    return ", ".join(map(str, every[:most])) + (f" and {len(every) - most} more" if len(every) > most else "")


def success_interval(successes: int, episodes: int) -> tuple[float, float]:
    """Rates between which the true one is, with a probability of at least 95 % (Clopper and Pearson, 1934)."""
    tail = (1.0 - CONFIDENCE) / 2.0
    # the rates at which so many successes or more, and so many or fewer, are just as improbable as the tail
    low = _root(lambda rate: _at_least(successes, episodes, rate) - tail)
    high = _root(lambda rate: tail - (1.0 - _at_least(successes + 1, episodes, rate)))
    return low if successes else 0.0, high if successes < episodes else 1.0


def decided(outcomes: Iterable[bool], low: float, high: float) -> tuple[int, float | None]:
    """Wald's sequential probability ratio test between two success rates, with errors of 5 %.

    Returns after how many episodes it decides, and for which rate; all of them and None if it does not.
    """
    bound = log((1.0 - _ERROR) / _ERROR)
    gain, loss = log(high / low), log((1.0 - high) / (1.0 - low))
    ratio, count = 0.0, 0
    for count, success in enumerate(outcomes, 1):
        ratio += gain if success else loss
        if abs(ratio) >= bound:
            return count, high if ratio > 0.0 else low
    return count, None


def _at_least(successes: int, episodes: int, rate: float) -> float:
    """The probability of so many successes or more."""
    if not 0.0 < rate < 1.0:
        return 1.0 if rate >= 1.0 or not successes else 0.0
    if successes > episodes * rate:
        return _tail(successes, episodes, rate)
    return 1.0 - _tail(episodes - successes + 1, episodes, 1.0 - rate)


def _tail(successes: int, episodes: int, rate: float) -> float:
    """The probability of so many successes or more, which are more than the most probable number."""
    if successes > episodes:
        return 0.0
    ways = lgamma(episodes + 1) - lgamma(successes + 1) - lgamma(episodes - successes + 1)
    term = total = exp(ways + successes * log(rate) + (episodes - successes) * log1p(-rate))
    for k in range(successes, episodes):
        term *= (episodes - k) / (k + 1) * rate / (1.0 - rate)
        total += term
        if term < _NEGLIGIBLE * total:
            break
    return total


def _root(rising: Callable[[float], float]) -> float:
    """Where a rising function of a rate is 0."""
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if rising(middle) > 0.0 else (middle, high)
    return 0.5 * (low + high)
