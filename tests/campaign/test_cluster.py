"""Campaigns on a Ray cluster of two nodes of this machine. Ray is in a separate extra: `make cluster` runs this."""

import socket
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from campaign_rig import write

from emulator.campaign.conduct import Conductor
from emulator.campaign.journal import Journal
from emulator.campaign.plan import read_plan
from emulator.campaign.work import Result, installed_version

ray = pytest.importorskip("ray")

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(300),
    pytest.mark.filterwarnings("ignore"),  # Ray's own
    pytest.mark.ur_leaves_things,
]

RUNS = 120
CAMPAIGN = f"""
script: work.script
limit_s: 60
matrix:
  seed: {{count: {RUNS}}}
"""
STORE_BYTES = 80_000_000  # the minimum for Ray
# Ray ends a node whose agents take 15 s to report the ports they chose (ray-project/ray#65983): so they are given
PORTS = ("metrics_agent_port", "metrics_export_port", "dashboard_agent_listen_port", "runtime_env_agent_port")
PROGRAM = """def work():
  movej([0.1, -1.2, 0.3, -1.5, 0.2, 0.4], a=4, v=3)
  sleep(20)
end
"""


def _node() -> dict[str, Any]:
    """A node of one core, its agents on free ports."""
    with ExitStack() as stack:
        taken = [stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in PORTS]
        ports = dict(zip(PORTS, (server.getsockname()[1] for server in taken), strict=True))
    return {"num_cpus": 1, "object_store_memory": STORE_BYTES, "include_dashboard": False, **ports}


def test_a_node_that_dies_midway_loses_and_duplicates_no_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from ray.cluster_utils import Cluster

    from emulator.campaign.workers import RayWorkers

    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("RAY_raylet_start_wait_time_s", "120")
    plan = read_plan(write(tmp_path, CAMPAIGN, PROGRAM))
    cluster = Cluster(initialize_head=True, head_node_args=_node())
    try:
        second = cluster.add_node(**_node())
        cluster.wait_for_nodes()
        workers = RayWorkers(cluster.address, plan.folder)
        counts: list[int] = []
        cores = [workers.size]

        def kill_a_node(results: list[Result]) -> None:
            counts.append(len(results))
            if sum(counts) >= RUNS // 4 and len(cores) == 1:
                cluster.remove_node(second, allow_graceful=False)
                cores.append(-1)

        try:
            with Journal(tmp_path / "out", plan, installed_version()) as journal:
                Conductor(plan, workers, journal, installed_version(), kill_a_node).run()
                results = list(journal.results())
            cores.append(workers.size)
        finally:
            workers.close()
    finally:
        cluster.shutdown()
    assert cores == [2, -1, 1]  # the node was killed before the end, and stayed away
    assert sorted(result.run for result in results) == list(range(RUNS))
    assert {(result.status, result.robot_s) for result in results} == {("passed", results[0].robot_s)}
