"""How sure a success rate is: the interval of Clopper and Pearson, and Wald's sequential test."""

from collections.abc import Callable, Iterable
from math import exp, lgamma, log, log1p
from typing import Final

CONFIDENCE: Final = 0.95
_ERROR: Final = 0.05  # of the sequential test, both ways
_BISECTIONS: Final = 60  # to the last bit of a float, about
_NEGLIGIBLE: Final = 1e-17


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
