"""Minutes of an eventful life: every byte of the primary and secondary ports matches construct's declarations.

Outside this suite, the official C++ library's strict parser was tested with an hour of the same life.
"""

from collections import Counter
from itertools import pairwise

import pytest
from primary_structs import FIRST_STATE_ONLY, NO_REQUEST, Reader, parts_of
from robot_life import EPISODES, Life

from urproto.modes import JointMode, RobotMode, SafetyMode

VERSIONS = [  # those between the oldest and the newest of a series: make long
    ("ur3", "3.1"),
    *(pytest.param(*pair, marks=pytest.mark.long) for pair in (("ur3", "3.2"), ("ur10", "3.5"))),
    ("ur3", "3.14"),
    ("ur5e", "5.4"),
    *(pytest.param(*pair, marks=pytest.mark.long) for pair in (("ur5e", "5.9"), ("ur3e", "5.12"), ("ur16e", "5.15"))),
    ("ur20", "5.25"),
]


def checked(version: str, stream: bytes) -> list[tuple[int, int | None, dict]]:
    """The stream's messages, checked against the rules of every version."""
    decoded = list(Reader(version).read(stream))
    assert decoded[0][:2] == (20, 3), "the version message is the first"
    states = [parts for kind, _, parts in decoded if kind == 16]
    fresh = parts_of(version)
    assert set(states[0]) == fresh
    assert all(set(parts) == fresh - FIRST_STATE_ONLY for parts in states[1:])
    stamps = [parts[0].timestamp for parts in states]
    assert all(0 < later - earlier <= 104_000 for earlier, later in pairwise(stamps))
    for parts in states:
        assert parts[0].robot_mode in set(RobotMode)
        assert parts[3].safety_mode in set(SafetyMode)
        assert {joint.mode for joint in parts[1].joints} <= set(JointMode)
    return decoded


@pytest.mark.parametrize(("model", "version"), VERSIONS)
def test_a_minute_of_every_message_layout(model: str, version: str) -> None:
    life = Life(model, version, seed=sum(map(ord, version)))
    life.run(60.0)
    decoded = checked(version, life.take())
    assert len([kind for kind, _, _ in decoded if kind == 16]) >= 600


@pytest.mark.parametrize(
    ("model", "version"), [("ur5", "3.15.8"), pytest.param("ur5e", "5.22", marks=pytest.mark.long)]
)
def test_every_kind_of_episode(model: str, version: str) -> None:
    life = Life(model, version)
    while len(life.happened) <= len(EPISODES):
        life.run(10.0)
    decoded = checked(version, life.take())
    counts = Counter((kind, sub) for kind, sub, _ in decoded)
    messages = {0, 3, 5, 6, 7, 9, 10, 12, 14}  # 12 follows the version
    assert counts.keys() == {(16, None), *((20, sub) for sub in messages), (25, 0), (25, 1), (25, 2)}
    requested = {message.body.requested_type for kind, sub, message in decoded if (kind, sub) == (20, 9)}
    assert requested == {0, 1, 2, 3, NO_REQUEST}
    modes = {parts[3].safety_mode for kind, _, parts in decoded if kind == 16}
    assert modes == set(range(SafetyMode.NORMAL, SafetyMode.FAULT + 1)) - {SafetyMode.RECOVERY}


def test_a_secondary_client_receives_only_states_and_the_version() -> None:
    life = Life("ur5", "3.15.8", "secondary")
    life.run(60.0)
    assert {(kind, sub) for kind, sub, _ in checked("3.15.8", life.take())} == {(20, 3), (20, 12), (16, None)}
