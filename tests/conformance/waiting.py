"""Waiting for a robot by its states and robot time, never by sleeping."""

from collections.abc import Callable, Mapping
from typing import Any

from client import BlockingRTDEClient

State = Mapping[str, Any]


def wait_until(client: BlockingRTDEClient, condition: Callable[[State], bool], timeout_s: float = 5.0) -> State:
    """The first state that meets the condition, within robot time; needs ``timestamp`` among the outputs."""
    state = client.latest()
    until = state["timestamp"] + timeout_s
    while not condition(state):
        assert state["timestamp"] < until, f"not within {timeout_s} s, the last state was {state}"
        state = client.receive()
    return state


def pass_time(client: BlockingRTDEClient, seconds: float) -> State:
    """Let robot time pass."""
    begin = client.latest()["timestamp"]
    return wait_until(client, lambda state: state["timestamp"] >= begin + seconds, seconds + 1.0)
