"""A controller manager that other processes talk to: what they may ask, and what cannot harm it. Time is ours."""

import asyncio
import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from controllers_rig import JOINTS, Bench
from hypothesis import given
from hypothesis import strategies as st

from client.controllers import protocol, serving, session
from client.controllers.remote import RemoteManager, check_no_manager
from client.controllers.running import Change, RunningManager
from client.controllers.serving import ManagerServer, claim
from client.controllers.session import Session
from client.errors import ControllerError, FileError, GoalRejectedError, ManagerError, NoManagerError
from urproto.compat_asyncio import timeout
from urproto.modes import RobotMode, SafetyMode

ROBOT = "127.9.9.9"
PORT = 30004


class Robot:
    """What a running manager needs of its robot, around a bench in virtual time."""

    def __init__(self, bench):
        self.bench = bench
        self.manager = bench.manager
        self.joints = JOINTS
        self.prefix = ""
        self.at_rest = True
        feed = SimpleNamespace(silent=False)
        link = SimpleNamespace(
            configuration=None, robot_mode=RobotMode.RUNNING, safety_mode=SafetyMode.NORMAL, feed=feed
        )
        state = {"actual_q": (0.0, 0.0), "target_speed_fraction": 1.0}
        config = SimpleNamespace(host=ROBOT)
        self.driver = SimpleNamespace(link=link, state=state, config=config, program_running=True)

    def check_reach(self, trajectory, *, speeds=True):
        pass


def running():
    return RunningManager(Robot(Bench()))


@pytest.fixture
def manager():
    return running()


@contextlib.asynccontextmanager
async def served(manager):
    with claim(ROBOT, PORT) as place:
        async with ManagerServer(manager, place):
            yield place


@pytest.fixture(params=["unix", "loopback"])
def kind(request, monkeypatch):
    """Systems without Unix sockets have a port and a token instead."""
    monkeypatch.setattr(protocol, "HAS_UNIX_SOCKETS", request.param == "unix")


def remote():
    return RemoteManager(ROBOT, PORT)


def point(*positions, time_s=1.0):
    return {"joint_names": list(JOINTS), "points": [{"positions": positions, "time_from_start_s": time_s}]}


@pytest.mark.usefixtures("kind")
async def test_controllers_go_through_their_lives(manager):
    async with served(manager), remote() as shell:
        assert shell.pid == os.getpid()
        assert await shell.request("list_controllers") == []
        assert (await shell.request("list_available"))["jtc"] == "joint_trajectory_controller/JointTrajectoryController"
        for name in ("jtc", "forward"):
            assert await shell.request("load_controller", name=name) == {"notes": []}
            await shell.request("configure_controller", name=name)
        with pytest.raises(ControllerError, match="jtc: it is already loaded"):
            await shell.request("load_controller", name="jtc")
        done = await shell.request("switch_controller", activate=["jtc"])
        assert done == {"activated": ["jtc"], "deactivated": []}
        with pytest.raises(
            ControllerError, match="forward: jtc has claimed shoulder_joint/position: deactivate it in the same"
        ):
            await shell.request("switch_controller", activate=["forward"])
        with pytest.raises(ControllerError, match="nonsense: it is not loaded"):
            await shell.request("switch_controller", activate=["forward", "nonsense"], deactivate=["jtc"])
        done = await shell.request(
            "switch_controller", activate=["forward", "nonsense"], deactivate=["jtc"], strictness="best_effort"
        )
        assert done == {"activated": ["forward"], "deactivated": ["jtc"]}
        first, second = await shell.request("list_controllers")
        assert (first["state"], second["state"]) == ("inactive", "active")
        assert second["claimed_interfaces"] == ["shoulder_joint/position", "elbow_joint/position"]
        with pytest.raises(ControllerError, match="it is active, which cannot be followed by shutdown"):
            await shell.request("unload_controller", name="forward")
        await shell.request("unload_controller", name="jtc")
        assert [one["name"] for one in await shell.request("list_controllers")] == ["forward"]
        claimed = {
            (one["kind"], one["name"]): one["claimed_by"] for one in await shell.request("list_hardware_interfaces")
        }
        assert claimed["command", "elbow_joint/position"] == "forward"
        assert claimed["command", "io/lamp"] == claimed["state", "elbow_joint/position"] == ""


async def test_parameters_are_set_as_a_whole_or_not_at_all(manager):
    shell = Session(manager)
    for do in ("load_controller", "configure_controller"):
        await shell.request(do, name="jtc")
    reported = []

    async def report(controller, change, values):
        reported.append((controller.name, change, dict(values)))

    manager.on_change.append(report)
    await shell.request("set_parameters", name="jtc", parameters={"constraints.goal_time": 0.5})
    found = await shell.request("list_parameters", name="jtc")
    assert found["constraints.goal_time"] == {"value": 0.5, "read_only": False}
    assert found["joints"] == {"value": list(JOINTS), "read_only": True}
    for values, words in (
        ({"constraints.goal_time": 1.0, "hurry": 1}, "it has no parameter"),
        ({"constraints.goal_time": 1.0, "joints": ["x"]}, "joints is read-only"),
        ({"constraints.goal_time": "soon"}, "constraints.goal_time must be a number"),
        ({"constraints.goal_time": 1.0, "interpolation_method": "x"}, "read-only"),
    ):
        with pytest.raises(ControllerError, match=words):
            await shell.request("set_parameters", name="jtc", parameters=values)
    assert manager.manager.controller("jtc").parameters.constraints.goal_time == 0.5
    assert reported == [("jtc", Change.PARAMETERS, {"constraints.goal_time": 0.5})]


async def test_two_shells_switch_at_once(manager):
    """One of them comes first, and the other is told why it cannot be: never both, never neither."""
    async with served(manager), remote() as one, remote() as other:
        for name in ("jtc", "forward"):
            await one.request("load_controller", name=name)
            await other.request("configure_controller", name=name)
        for _ in range(20):
            results = await asyncio.gather(
                one.request("switch_controller", activate=["jtc"]),
                other.request("switch_controller", activate=["forward"]),
                return_exceptions=True,
            )
            assert sorted(isinstance(result, ControllerError) for result in results) == [False, True]
            (active,) = [one.name for one in manager.manager.active()]
            await one.request("switch_controller", deactivate=[active])


async def test_what_a_client_began_ends_with_it(manager):
    bench = manager.control.bench
    manager.manager.activate("jtc")
    async with served(manager):
        async with remote() as shell:
            number = await shell.request("send_goal", controller="jtc", trajectory=point(1.0, 1.0))
            bench.run(0.3)
            goal = manager.manager.controller("jtc").goal
            assert 0.0 < (await shell.request("goal", goal=number))["progress"] < 1.0
            with pytest.raises(GoalRejectedError, match="has no joint x"):
                await shell.request(
                    "send_goal", controller="jtc", trajectory={**point(1.0, 1.0), "joint_names": ["x", "y"]}
                )
        await _until(lambda: goal.done)
        assert goal.status.name == "CANCELED"
        bench.run(1.0)
        assert max(bench.q) < 0.6
        manager.manager.deactivate("jtc")
        manager.manager.activate("speeds")
        async with remote() as shell:
            await shell.request("forward_command", controller="speeds", values=[0.5, 0.0], hold=True)
            bench.run(0.1)
            assert bench.joints.commands["shoulder_joint/velocity"] == 0.5
            await asyncio.sleep(0)
        await _until(lambda: bench.cycle() or bench.joints.commands["shoulder_joint/velocity"] == 0.0)


async def test_a_goal_is_followed_to_its_end(manager):
    bench = manager.control.bench
    manager.manager.activate("jtc")
    async with served(manager), remote() as shell:
        number = await shell.request("send_goal", controller="jtc", trajectory=point(0.5, -0.5))
        bench.run(1.5)
        assert (await shell.request("goal", goal=number)).items() >= {"error_code": 0, "progress": 1.0}.items()
        assert bench.q == pytest.approx((0.5, -0.5), abs=1e-6)
        with pytest.raises(ManagerError, match="has no goal 1"):
            await shell.request("goal", goal=number)


def test_positions_are_gone_to_gradually_and_wait_when_the_arm_does():
    bench = Bench()
    bench.manager.activate("forward")
    bench.cycle()
    bench.joints.commands.lend(["shoulder_joint/position", "elbow_joint/position"]).fill(0.0)
    forward, pace = bench.manager.controller("forward"), [1.0]
    forward.go_to((1.0, -1.0), 2.0, lambda: pace[0])
    places = []
    for share in (1.0, 0.0, 1.0):
        pace[0] = share
        for _ in range(100):
            bench.cycle()
            places.append(bench.joints.commands["shoulder_joint/position"])
    steps = [b - a for a, b in itertools.pairwise(places)]
    assert max(steps) < 1.01 * 1.5 * 1.0 / 2.0 / 100.0  # rad a cycle: the cubic's top speed
    assert places[99] == pytest.approx(places[199])
    assert places[-1] == 1.0


# what comes from outside


async def _until(condition):
    async with timeout(20.0):
        while not condition():
            await asyncio.sleep(0.005)


async def _open(place):
    return await asyncio.open_unix_connection(f"{place}.sock")


HELLO = b'{"protocol":1}\n'


@pytest.mark.parametrize(
    ("data", "answer"),
    [
        (b"GET / HTTP/1.1\r\n", "not a JSON message"),
        (b"\x00\xff\n", "not a JSON message"),
        (b"[1]\n", "must be a JSON object"),
        (b'{"protocol":2}\n', "speaks protocol 1, not 2"),
        (HELLO + b"[" * 100_000 + b"\n", "not a JSON message"),
        (HELLO + b'{"id":' + b"9" * 5000 + b"}\n", "not a JSON message"),
        (HELLO + b'{"id":1,"do":"goal","goal":NaN}\n', "not a JSON message"),
        (HELLO + b'{"id":"1","do":"goal"}\n', "a request must have an id"),
        (HELLO + b'{"id":1}\n', "a request must have an id"),
        (HELLO + b"x" * (protocol.MAX_REQUEST + 10) + b"\n", "bytes at most"),
    ],
)
async def test_invalid_messages_are_answered_with_an_error_and_disconnected(manager, data, answer):
    async with served(manager) as place:
        reader, writer = await _open(place)
        writer.write(data)
        received = await reader.read()
        writer.close()
        assert answer in json.loads(received.splitlines()[-1])["error"]["text"]
        async with remote() as shell:
            assert await shell.request("list_controllers") == []


LEAVES = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
LISTS = st.lists(LEAVES, max_size=3)
JSON = LEAVES | LISTS | st.dictionaries(st.text(max_size=8), LEAVES | LISTS, max_size=3) | st.lists(LISTS, max_size=2)
NAMES = ("name", "controller", "activate", "deactivate", "values", "trajectory", "parameters", "goal", "type", "state")


@given(
    do=st.sampled_from(sorted(session._HANDLERS)) | st.text(max_size=10),
    arguments=st.dictionaries(
        st.sampled_from(NAMES) | st.text(max_size=6),
        JSON | st.sampled_from(["jtc", "forward"]) | st.just(["jtc"]) | st.just(point(0.1, 0.1)),
        max_size=5,
    ),
)
def test_every_request_has_one_answer_and_the_control_loop_goes_on(do, arguments):
    """Whatever JSON can say; numbers that it cannot say come as null."""
    bench = Bench()
    manager = RunningManager(Robot(bench))
    manager.manager.activate("jtc")

    async def send_request():
        session = Session(manager)
        line = json.dumps({**json.loads(protocol.encoded(arguments)), "id": 7, "do": do}).encode() + b"\n"
        answer = json.loads(protocol.encoded(await serving._answer(session, line)))
        await session.close()
        return answer

    if do not in ("make_ready", "set_speed_slider", "begin_recording", "set_hardware_component_state"):  # the robot's
        answer = asyncio.run(send_request())
        assert answer.keys() in ({"id", "result"}, {"id", "error"})
        assert answer["id"] == 7
        assert "failed: " not in answer.get("error", {}).get("text", "")
    before = bench.manager.time_s
    bench.cycle()
    assert bench.manager.time_s > before


@given(st.binary(max_size=200))
def test_bytes_are_a_message_or_a_manager_error(line):
    with contextlib.suppress(ManagerError):
        assert isinstance(protocol.decoded(line), dict)


async def test_a_client_that_never_reads_delays_no_other(manager, monkeypatch):
    monkeypatch.setattr(serving, "_DRAIN_S", 0.3)
    for number in range(40):  # long answers
        await manager.load(f"jtc{number}", "joint_state_broadcaster/JointStateBroadcaster", {})
    async with served(manager) as place:
        reader, deaf = await _open(place)
        deaf.write(HELLO)
        await reader.readline()
        request = b'{"id":1,"do":"list_controllers"}\n'
        deaf.write(request * 2000)
        async with remote() as shell, timeout(20.0):
            for _ in range(50):
                assert len(await shell.request("list_controllers")) == 40
            deaf.transport.pause_reading()
            with contextlib.suppress(OSError):
                while not deaf.is_closing():
                    deaf.write(request)
                    await asyncio.sleep(0.01)
        deaf.transport.abort()


async def test_too_many_connections_are_refused(manager, monkeypatch):
    monkeypatch.setattr(serving, "_MAX_CONNECTIONS", 2)
    async with served(manager), remote(), remote():
        with pytest.raises(ManagerError, match="2 programs are already connected"):
            async with remote():
                pass


# where they meet


async def test_without_a_manager_the_error_explains_how_to_start_it(manager):
    with pytest.raises(NoManagerError, match=f"ur-client controllers serve --robot-ip {ROBOT}"):
        async with remote():
            pass
    await check_no_manager(ROBOT, PORT)
    async with served(manager) as place:
        with pytest.raises(ManagerError, match="one control program at a time: end the manager first"):
            await check_no_manager(ROBOT, PORT)
        with pytest.raises(ManagerError, match=f"already running \\(process {os.getpid()}\\)"), claim(ROBOT, PORT):
            pass
        with pytest.raises(NoManagerError):  # of another robot at that address
            async with RemoteManager(ROBOT, PORT + 1):
                pass
        folder = place.parent
        assert (folder.stat().st_mode & 0o777, (folder / f"{place.name}.sock").stat().st_mode & 0o777) == (0o700, 0o600)
    assert list(folder.glob(f"{place.name}*")) == []


KILLED = """
import asyncio, sys
sys.path[:] = {path!r}
from client.controllers.serving import ManagerServer, claim
async def serve():
    with claim({robot!r}, {port}) as place:
        async with ManagerServer(None, place):
            print("up", flush=True)
            await asyncio.sleep(1e6)
asyncio.run(serve())
"""


async def test_a_manager_that_was_killed_is_none_and_the_next_one_takes_its_place(manager):
    code = KILLED.format(path=sys.path, robot=ROBOT, port=PORT)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as process:
        assert await asyncio.to_thread(process.stdout.readline) == b"up\n"
        with pytest.raises(ManagerError, match=f"process {process.pid}"), claim(ROBOT, PORT):
            pass
        process.send_signal(signal.SIGSTOP)
        shell = remote()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("client.controllers.remote._CONNECT_S", 0.2)
            with pytest.raises(ManagerError, match=r"has not answered for 0\.2 s: is it suspended"):
                await shell.__aenter__()
        process.kill()
    place = protocol.rendezvous_path(ROBOT, PORT)
    assert place.with_name(f"{place.name}.sock").exists()
    with pytest.raises(NoManagerError):
        await shell.__aenter__()
    async with served(manager), remote() as other:
        assert other.pid == os.getpid()


async def test_the_end_of_the_manager_is_reported(manager):
    async with contextlib.AsyncExitStack() as ending:
        await ending.enter_async_context(served(manager))
        shell = await remote().__aenter__()
        await shell.request("list_controllers")
        await ending.aclose()
        with pytest.raises(ManagerError, match="has ended: start it again"):
            await shell.request("list_controllers")
        await shell.__aexit__(None, None, None)


def test_folders_of_others_are_not_trusted(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "ur-client").symlink_to(tmp_path)
    with pytest.raises(FileError, match="not a folder of this user"):
        protocol.rendezvous_path(ROBOT, PORT)
    (tmp_path / "ur-client").unlink()
    (tmp_path / "ur-client").mkdir(mode=0o777)
    (tmp_path / "ur-client").chmod(0o777)
    protocol.rendezvous_path(ROBOT, PORT)
    assert (tmp_path / "ur-client").stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / ("x" * 100)))
    with pytest.raises(FileError, match="too long for a Unix socket"):
        protocol.rendezvous_path(ROBOT, PORT)


def test_robots_have_places_of_their_own():
    hosts = ["127.0.0.1", "127.0.0.2", "a/b", "a_b", "x" * 60, "x" * 61, "../../etc"]
    places = {protocol.rendezvous_path(host, port) for host in hosts for port in (PORT, PORT + 1)}
    assert len(places) == 2 * len(hosts)
    assert {place.parent for place in places} == {Path(os.environ["XDG_RUNTIME_DIR"]) / "ur-client"}
    assert protocol.rendezvous_path("localhost", PORT) == protocol.rendezvous_path("127.0.0.1", PORT)


async def test_on_the_loopback_interface_the_token_is_needed(manager, monkeypatch):
    monkeypatch.setattr(protocol, "HAS_UNIX_SOCKETS", False)
    async with served(manager) as place:
        file = place.with_name(f"{place.name}.json")
        assert file.stat().st_mode & 0o777 == 0o600
        file.write_text(json.dumps({**json.loads(file.read_text()), "token": "guess"}))
        with pytest.raises(ManagerError, match="the token does not match"):
            async with remote():
                pass
        file.write_text("garbage")
        with pytest.raises(NoManagerError):
            async with remote():
                pass
