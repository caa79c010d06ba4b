"""Signals end waiting, but not writing."""

import os
import signal

import pytest

from client.commands.following import Interrupts


def test_a_signal_ends_waiting() -> None:
    with Interrupts() as interrupts, pytest.raises(KeyboardInterrupt):
        interrupts.wait(lambda: os.kill(os.getpid(), signal.SIGTERM) or signal.sigwait([signal.SIGUSR1]))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_a_write_ends_the_next_wait(number: signal.Signals) -> None:
    written = []
    with Interrupts() as interrupts:
        os.kill(os.getpid(), number)
        written.append("the rest")
        with pytest.raises(KeyboardInterrupt):
            interrupts.wait(lambda: written.append("never"))
    assert written == ["the rest"]


def test_previous_signal_handlers_are_restored() -> None:
    before = signal.getsignal(signal.SIGTERM)
    with Interrupts():
        assert signal.getsignal(signal.SIGTERM) != before
    assert signal.getsignal(signal.SIGTERM) == before
