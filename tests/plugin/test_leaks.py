"""Resources left behind by a test with a robot make it fail, and nothing else does."""

import re
import socket
from contextlib import ExitStack

import pytest

from tests.budget import subset
from urproto.testing.leaks import listening_sockets

LEAVING = {
    "threads: forgotten": """
        def leave():
            threading.Thread(target=END.wait, name="forgotten", daemon=True).start()
    """,
    "listening ports: port ": """
        def leave():
            KEPT.append(socket.create_server(("127.0.0.1", 0)))
    """,
    "asyncio tasks: lost (sleep)": """
        async def leave():
            KEPT.append(asyncio.create_task(asyncio.sleep(1000), name="lost"))
    """,
}
HEAD = "import asyncio, socket, threading\nimport pytest\nEND = threading.Event()\nKEPT = []\n"


def using(leave: str, head: str = "") -> str:
    """A test that uses a robot and leaves something behind; then one that does not."""
    is_async = "async " in leave
    marker = "@pytest.mark.asyncio\n" if is_async else ""
    body = "\n".join(line[8:] for line in leave.splitlines())
    call = "await leave()" if is_async else "leave()"
    return (
        f"{HEAD}{body}\n{head}{marker}{'async ' if is_async else ''}def test_it(ur_robot):\n    {call}\n"
        "def test_next(ur_robot): pass\n"
    )


@pytest.mark.parametrize("what", subset(LEAVING, now=["threads: forgotten"]))
def test_a_leak_fails_the_test_that_caused_it(run_tests, what: str) -> None:
    result = run_tests(using(LEAVING[what]))
    result.assert_outcomes(passed=2, errors=1)
    result.stdout.fnmatch_lines([f"left behind by the test: {what}*"])


@pytest.mark.parametrize("what", subset(LEAVING, now=["listening ports: port "]))
def test_leaks_can_be_allowed_by_a_marker(run_tests, what: str) -> None:
    run_tests(using(LEAVING[what], "@pytest.mark.ur_leaves_things\n")).assert_outcomes(passed=2)


def test_tests_without_robots_are_not_checked(run_tests) -> None:
    run_tests(using(LEAVING["threads: forgotten"]).replace("ur_robot", "")).assert_outcomes(passed=2)


def test_resources_that_end_in_time_or_belong_to_a_fixture_are_accepted(run_tests) -> None:
    run_tests(
        HEAD
        + """
import time

@pytest.fixture(scope="session")
def service():
    server = socket.create_server(("127.0.0.1", 0))
    thread = threading.Thread(target=END.wait)
    thread.start()
    yield
    END.set()
    thread.join()
    server.close()

@pytest.fixture
async def worker(ur_robot):
    task = asyncio.create_task(asyncio.sleep(1000))
    yield
    task.cancel()

def test_of_a_session(ur_robot, service): pass

def test_ending(ur_robot):
    threading.Thread(target=time.sleep, args=(0.2,)).start()

@pytest.mark.asyncio
async def test_tasks(worker):
    await asyncio.to_thread(lambda: None)
""",
        "-o", "asyncio_mode=auto",
    ).assert_outcomes(passed=3)  # fmt: skip


def test_a_failure_is_reported_once(run_tests) -> None:
    source = using(LEAVING["threads: forgotten"]).replace("    leave()\n", "    leave()\n    assert False\n")
    run_tests(source).assert_outcomes(passed=1, failed=1)


def test_only_listening_tcp_sockets_count_as_leaks() -> None:
    before = listening_sockets()
    with ExitStack() as opened:
        servers = [
            opened.enter_context(socket.create_server((host, 0), family=family))
            for host, family in (("127.0.0.1", socket.AF_INET), ("::1", socket.AF_INET6))
        ]
        opened.enter_context(socket.create_connection(servers[0].getsockname()[:2]))
        opened.enter_context(socket.socket(type=socket.SOCK_DGRAM)).bind(("127.0.0.1", 0))
        local = opened.enter_context(socket.socket(socket.AF_UNIX))
        local.bind("")  # Linux chooses a name
        local.listen()
        found = listening_sockets() - before
        ports = sorted(server.getsockname()[1] for server in servers)
        assert sorted(int(re.match(r"port (\d+) \(socket:\[\d+\]\)$", one)[1]) for one in found) == ports
    assert listening_sockets() == before
