"""The distribution of tests over several workers."""

import os

import pytest

from tests.conftest import IN_REAL_TIME


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="pytest runs without workers")
@pytest.mark.xdist_group(IN_REAL_TIME)
def test_a_group_stays_on_one_worker(request: pytest.FixtureRequest) -> None:
    """pytest-xdist's scheduler knows a group by the end of the id that its workers give to a test."""
    if not request.config.getoption("loadgroup", False):
        pytest.skip("the tests are shared out without groups")
    assert request.node.nodeid.endswith(f"@{IN_REAL_TIME}")
