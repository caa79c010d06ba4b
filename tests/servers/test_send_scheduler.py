"""The number of state packages per control period is limited; many clients take turns, a few are unaffected."""

from dataclasses import dataclass, field

import pytest

from emulator.servers.send_scheduler import PACKAGES_PER_SECOND, SendScheduler, StateFeed
from tests.rows import each_row

PERIOD_S = 0.002
MAX_PER_PERIOD = round(PACKAGES_PER_SECOND * PERIOD_S)


@dataclass(eq=False)
class Listener:
    seen: list[bytes] = field(default_factory=list)
    takes_state: bool = True
    skipped: int = 0

    def send_state(self, data: bytes) -> None:
        self.seen.append(data)

    def skip_state(self) -> None:
        self.skipped += 1


def publish(scheduler: SendScheduler, listeners: list[Listener], step: int) -> int:
    """One control period; the number of packages sent."""
    before = sum(len(listener.seen) for listener in listeners)
    scheduler.next_period(step)
    for listener in listeners:
        scheduler.send(step, listener, b"%d" % step)
    return sum(len(listener.seen) for listener in listeners) - before


@each_row("count", [1, 5, MAX_PER_PERIOD])
def test_few_clients_get_each_package_in_its_period(count: int) -> None:
    scheduler, listeners = SendScheduler(PERIOD_S), [Listener() for _ in range(count)]
    for step in range(1, 50):
        assert publish(scheduler, listeners, step) == count
    assert all(listener.seen == [b"%d" % step for step in range(1, 50)] for listener in listeners)


def check_turns(listeners: list[Listener], last_step: int) -> None:
    """Each got about the same number of packages, in order, without duplicates, and up to date."""
    counts = [len(listener.seen) for listener in listeners]
    assert max(counts) - min(counts) <= 0.2 * max(counts)
    for listener in listeners:
        steps = list(map(int, listener.seen))
        assert steps == sorted(set(steps))
        assert steps[-1] >= last_step - len(listeners) // MAX_PER_PERIOD - 2


def test_many_clients_take_turns_and_get_the_newest_package() -> None:
    scheduler, listeners = SendScheduler(PERIOD_S), [Listener() for _ in range(256)]
    for step in range(1, 300):
        assert publish(scheduler, listeners, step) <= MAX_PER_PERIOD
    check_turns(listeners, last_step=299)


def test_a_burst_is_served_within_the_next_periods() -> None:
    scheduler, listeners = SendScheduler(PERIOD_S), [Listener() for _ in range(128)]
    publish(scheduler, listeners, 1)
    for step in range(2, 2 + 128 // MAX_PER_PERIOD + 1):
        scheduler.next_period(step)
    assert all(listener.seen == [b"1"] for listener in listeners)


def test_a_client_that_does_not_read_takes_no_turns() -> None:
    scheduler, deaf, listener = SendScheduler(PERIOD_S), [Listener(takes_state=False) for _ in range(500)], Listener()
    for step in range(1, 20):
        assert publish(scheduler, [*deaf, listener], step) == 1


def test_packages_that_belong_together_stay_together() -> None:
    scheduler, listeners = SendScheduler(PERIOD_S), [Listener() for _ in range(MAX_PER_PERIOD)]
    for step in (1, 2, 3, 4):
        scheduler.next_period(step)
        if step == 1:
            for listener in listeners:
                scheduler.send(step, listener, b"program", b"state")
    assert all(listener.seen == [b"program", b"state"] for listener in listeners)


def test_disconnected_clients_are_removed() -> None:
    scheduler, listeners = SendScheduler(PERIOD_S), [Listener() for _ in range(2 * MAX_PER_PERIOD)]
    publish(scheduler, listeners, 1)
    scheduler.remove(listeners[-1])
    scheduler.next_period(2)
    assert listeners[-2].seen == [b"1"]
    assert listeners[-1].seen == []


def publish_feed(scheduler: SendScheduler, feed: StateFeed, step: int) -> None:
    scheduler.publish(step, feed, b"%d" % step)


def test_few_clients_of_a_feed_get_each_package_in_its_period() -> None:
    scheduler, feed = SendScheduler(PERIOD_S), StateFeed()
    listeners = [Listener() for _ in range(MAX_PER_PERIOD)]
    feed.up_to_date.extend(listeners)
    for step in range(1, 50):
        publish_feed(scheduler, feed, step)
    assert all(listener.seen == [b"%d" % step for step in range(1, 50)] for listener in listeners)


def test_clients_of_two_feeds_take_turns_and_get_the_newest_package() -> None:
    scheduler, feeds = SendScheduler(PERIOD_S), [StateFeed(), StateFeed()]
    listeners = [Listener() for _ in range(256)]
    for number, listener in enumerate(listeners):
        feeds[number % 2].up_to_date.append(listener)
    for step in range(1, 300):
        before = sum(len(listener.seen) for listener in listeners)
        for feed in feeds:
            publish_feed(scheduler, feed, step)
        assert sum(len(listener.seen) for listener in listeners) - before <= MAX_PER_PERIOD + 1
    check_turns(listeners, last_step=299)


def test_clients_of_a_feed_that_do_not_read_take_no_turns() -> None:
    scheduler, feed = SendScheduler(PERIOD_S), StateFeed()
    deaf, listener = [Listener(takes_state=False) for _ in range(500)], Listener()
    feed.up_to_date.extend([*deaf, listener])
    for step in range(1, 50):
        publish_feed(scheduler, feed, step)
    assert len(listener.seen) == 49
    assert all(one.skipped for one in deaf)
    deaf[0].takes_state = True  # it reads again
    for step in range(50, 60):
        publish_feed(scheduler, feed, step)
    assert deaf[0].seen[-1] == b"59"


def test_a_client_removed_from_a_feed_gets_nothing_more() -> None:
    scheduler, feed, listener = SendScheduler(PERIOD_S), StateFeed(), Listener()
    feed.up_to_date.append(listener)
    publish_feed(scheduler, feed, 1)
    feed.remove(listener)
    scheduler.remove(listener)
    publish_feed(scheduler, feed, 2)
    assert listener.seen == [b"1"]


class Failing(Listener):
    """Fails at its second package, as a fault's hook can."""

    def send_state(self, data: bytes) -> None:
        super().send_state(data)
        if len(self.seen) == 2:
            raise OSError("a hook failed")


@each_row("place", [0, 1, 2])
def test_a_failing_client_does_not_silence_the_others(place: int) -> None:
    scheduler, feed = SendScheduler(PERIOD_S), StateFeed()
    listeners = [Failing() if number == place else Listener() for number in range(3)]
    feed.up_to_date.extend(listeners)
    publish_feed(scheduler, feed, 1)
    with pytest.raises(OSError, match="a hook failed"):
        publish_feed(scheduler, feed, 2)
    publish_feed(scheduler, feed, 3)
    assert all(listener.seen[-1] == b"3" for listener in listeners)
