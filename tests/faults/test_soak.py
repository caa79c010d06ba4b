"""A short part of the soak test: see soak.py."""

import pytest
from soak import soak


@pytest.mark.parametrize(("model", "seconds"), [("ur3", 12.0), pytest.param("ur5e", 10.0, marks=pytest.mark.long)])
async def test_random_faults_and_clients_leave_nothing_behind(model: str, seconds: float) -> None:
    run = await soak(model, minutes=2, seed=11, seconds=seconds)
    assert run.connected > 5
    assert sum(run.struck.values()) > 5
