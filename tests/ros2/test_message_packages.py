"""Message packages that a machine lacks: the definitions, what `ensure` does, and what it says when it cannot."""

import io
import json
import os
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from client.commands.ros2 import prepare
from client.errors import Ros2Error
from client.ros2 import message_packages
from client.ros2.message_builder import python_folder, rosidl
from client.ros2.message_packages import DISTRIBUTIONS, PACKAGES, Ros2Installation, definitions, ensure
from tests.rows import each_row

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def as_if_none_were_made(monkeypatch):
    """Other tests of this process may have put those of the cache into its paths."""
    made = str(message_packages.default_cache())
    for name in ("AMENT_PREFIX_PATH", "PYTHONPATH"):  # what a workspace has put there stays
        paths = os.environ.get(name, "").split(os.pathsep)
        monkeypatch.setenv(name, os.pathsep.join(path for path in paths if not path.startswith(made)))
    monkeypatch.setattr(sys, "path", [path for path in sys.path if not path.startswith(made)])
    for name in PACKAGES:
        monkeypatch.delitem(sys.modules, name, raising=False)


def published() -> dict[str, dict[str, str]]:
    """Type hashes by distribution and type."""
    hashes: dict[str, dict[str, str]] = {name: {} for name in DISTRIBUTIONS}
    for line in (HERE / "type_hashes.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            names, kind, digest = line.split()
            for name in names.split("+"):
                hashes[name][kind] = f"RIHS01_{digest}"
    return hashes


@each_row("distribution", DISTRIBUTIONS)
def test_messages_have_the_published_type_hashes(distribution):
    """As rosbags computes them, which shares nothing with rosidl."""
    store = get_typestore(Stores.ROS2_HUMBLE if distribution == "humble" else Stores.ROS2_JAZZY)
    ours = {}
    for package in PACKAGES:
        for file, text in definitions(package, distribution).items():
            if file.startswith("msg/"):
                ours |= get_types_from_msg(text, f"{package}/{file.removesuffix('.msg')}")
    store.register({name: kind for name, kind in ours.items() if name not in store.types})
    assert {name: store.hash_rihs01(name) for name in ours} == {
        name: digest for name, digest in published()[distribution].items() if "/msg/" in name
    }


@each_row("distribution", DISTRIBUTIONS)
def test_there_is_a_definition_of_every_published_type(distribution):
    ours = {
        f"{package}/{file.rsplit('.', 1)[0]}" for package in PACKAGES for file in definitions(package, distribution)
    }
    assert ours == set(published()[distribution])


# Stands in for the builder: writes what it is told, and waits as long as it is told.
FAKE = f"""
import json, os, sys, time
from pathlib import Path
sys.path.insert(0, {str(HERE.parents[1])!r})
"""
FAKE += """
from client.ros2.message_builder.packages import is_complete, record
plan = json.load(sys.stdin)
with open(os.environ["CALLS"], "a") as calls:
    calls.write("built\\n")
while os.path.exists(os.environ["CALLS"] + ".wait"):
    time.sleep(0.01)
modules = "lib/python{}.{}/site-packages".format(*sys.version_info)
prefix = Path(plan["prefix"])
for name, version, files in plan["packages"]:
    if is_complete(prefix, name):
        continue
    folder = prefix / modules / name
    folder.mkdir(parents=True, exist_ok=True)
    with open(os.environ["CALLS"], "a") as calls:
        calls.write(f"{name}\\n")
    print("0.5 making", name, flush=True)
    if os.environ.get("FAIL"):
        print("error no compiler for", name)
        sys.exit(1)
    while os.path.exists(os.environ["CALLS"] + "." + name):
        time.sleep(0.01)
    (folder / "__init__.py").write_text(f"VERSION = {version!r}")
    record(prefix, name)
"""


@pytest.fixture
def builder(tmp_path, monkeypatch):
    """A builder that takes no time, and a file with a line for each of its runs."""
    fake = tmp_path / "fake"
    fake.mkdir()
    (fake / "__main__.py").write_text(FAKE)
    calls = tmp_path / "calls"
    calls.touch()
    installation = Ros2Installation("jazzy", (tmp_path,), sourced=False)
    monkeypatch.setattr(message_packages, "_BUILDER", fake)
    monkeypatch.setattr(message_packages, "missing", lambda: ("ur_msgs",))
    monkeypatch.setattr(message_packages, "find_installation", lambda: installation)
    monkeypatch.setenv("CALLS", str(calls))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "")
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.setattr(sys, "path", list(sys.path))
    return calls


def runs(calls: Path) -> int:
    return calls.read_text().split().count("built")


def made(calls: Path) -> list[str]:
    return [line for line in calls.read_text().split() if line != "built"]


def test_nothing_is_made_where_nothing_is_missing(tmp_path, monkeypatch):
    monkeypatch.setattr(message_packages, "missing", tuple)
    before = list(sys.path)
    packages = ensure(cache=tmp_path)
    assert (packages.prefix, packages.setup_file, packages.environment()) == (None, None, {})
    assert sys.path == before
    assert not list(tmp_path.iterdir())


def test_packages_are_made_once_and_found_by_this_process_and_its_children(tmp_path, builder):
    reported = []
    packages = ensure(lambda part, what: reported.append((part, what)), tmp_path / "cache")
    assert reported == [(0.5, "making ur_msgs")]
    assert str(python_folder(packages.prefix)) in sys.path
    child = subprocess.run(
        [sys.executable, "-c", "import ur_msgs; print(ur_msgs.VERSION)"], capture_output=True, text=True
    )
    assert child.stdout == "2.6.0\n", child.stderr
    assert os.environ["AMENT_PREFIX_PATH"] == f"{packages.prefix}:{tmp_path}"

    again = ensure(cache=tmp_path / "cache")
    assert again.prefix == packages.prefix
    assert runs(builder) == 1
    assert [path.name for path in packages.prefix.parent.iterdir() if path.is_dir()] == [packages.prefix.name]


def test_a_shell_finds_them_by_the_setup_file(tmp_path, builder):
    packages = ensure(cache=tmp_path / "cache")
    script = f'. {packages.setup_file}; {sys.executable} -c "import ur_msgs"; echo $? $AMENT_PREFIX_PATH'
    shell = subprocess.run(["sh", "-c", script], capture_output=True, text=True, env={"PATH": os.environ["PATH"]})
    assert shell.stdout == f"0 {packages.prefix}:{tmp_path}\n", shell.stderr


@pytest.mark.parametrize(
    "damage", ["a file is gone", "a file is cut", "the manifest is gone", "the manifest is not one"]
)
def test_a_broken_cache_is_made_anew(tmp_path, builder, damage):
    prefix = ensure(cache=tmp_path / "cache").prefix
    module = python_folder(prefix) / "ur_msgs/__init__.py"
    manifest = prefix / "manifests/ur_msgs.json"
    if damage == "a file is gone":
        module.unlink()
    elif damage == "a file is cut":
        module.write_text("")
    elif damage == "the manifest is gone":
        manifest.unlink()
    else:
        manifest.write_text("[]")
    ensure(cache=tmp_path / "cache")
    assert module.read_text() == "VERSION = '2.6.0'"
    assert runs(builder) == 2


def test_two_at_once_make_them_once(tmp_path, builder):
    wait = Path(f"{builder}.wait")
    wait.touch()
    waited = threading.Event()
    first = threading.Thread(target=ensure, kwargs={"cache": tmp_path / "cache"})
    first.start()
    try:
        while not runs(builder):
            waited.wait(0.01)
        second = threading.Thread(target=ensure, args=(lambda part, what: waited.set(), tmp_path / "cache"))
        second.start()
        assert waited.wait(20)  # told that somebody else is at it
    finally:
        wait.unlink()
    first.join(20)
    second.join(20)
    assert runs(builder) == 1


def test_an_interrupted_build_resumes_with_the_package_it_was_at(tmp_path, builder, monkeypatch):
    monkeypatch.setattr(message_packages, "missing", lambda: ("tf2_msgs", "ur_msgs"))

    def interrupt(part, what):
        if what == "making ur_msgs":
            raise KeyboardInterrupt

    stop = Path(f"{builder}.ur_msgs")
    stop.touch()
    with pytest.raises(KeyboardInterrupt):
        ensure(interrupt, tmp_path / "cache")
    stop.unlink()
    prefix = ensure(cache=tmp_path / "cache").prefix
    assert made(builder) == ["tf2_msgs", "ur_msgs", "ur_msgs"]
    assert [path.name for path in prefix.parent.iterdir() if path.is_dir()] == [prefix.name]


def test_after_a_killed_process_the_next_one_waits_for_its_builder_and_resumes(tmp_path, builder, monkeypatch):
    stop = Path(f"{builder}.ur_msgs")
    stop.touch()
    script = f"""
        from pathlib import Path
        from client.ros2 import message_packages
        message_packages._BUILDER = Path({str(message_packages._BUILDER)!r})
        message_packages.missing = lambda: ("tf2_msgs", "ur_msgs")
        installation = message_packages.Ros2Installation("jazzy", (Path({str(tmp_path)!r}),), sourced=False)
        message_packages.find_installation = lambda: installation
        message_packages.ensure(lambda part, what: print(what, flush=True))
    """
    killed = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1]), "UR_CLIENT_ROS2_CACHE": str(tmp_path / "cache")},
    )
    assert killed.stdout is not None
    while killed.stdout.readline() != "making ur_msgs\n":
        assert killed.poll() is None
    killed.kill()
    killed.wait()
    killed.stdout.close()
    reported = []

    def go_on(part, what):
        reported.append(what)
        stop.unlink(missing_ok=True)

    monkeypatch.setattr(message_packages, "missing", lambda: ("tf2_msgs", "ur_msgs"))
    ensure(go_on, tmp_path / "cache")
    assert reported[0] == "another process is building the message packages"
    assert made(builder) == ["tf2_msgs", "ur_msgs"]


def test_without_a_terminal_there_is_a_line_for_each_package(monkeypatch, capfd):
    def ensure(progress):
        for part, name in ((0.0, "control_msgs"), (0.1, "control_msgs"), (0.5, "ur_msgs")):
            progress(part, f"compiling {name}")
        return message_packages.MessagePackages()

    monkeypatch.setattr(message_packages, "missing", lambda: ("ur_msgs",))
    monkeypatch.setattr(message_packages, "ensure", ensure)
    prepare()
    lines = [line for line in capfd.readouterr().err.splitlines() if line]
    assert [line.split(": ")[1] for line in lines] == ["compiling control_msgs (0%)", "compiling ur_msgs (50%)"]


def test_a_failure_is_reported_with_its_cause_and_the_next_build_succeeds(tmp_path, builder, monkeypatch):
    monkeypatch.setenv("FAIL", "1")
    with pytest.raises(
        Ros2Error, match=r"cannot build the message packages .*ur_msgs: no compiler for ur_msgs\. Details: .*\.log"
    ):
        ensure(cache=tmp_path / "cache")
    monkeypatch.delenv("FAIL")
    assert ensure(cache=tmp_path / "cache").setup_file.is_file()


def test_a_cache_that_cannot_be_written_is_named(tmp_path, builder):
    (tmp_path / "file").touch()
    with pytest.raises(Ros2Error, match=r"in .*file/cache \(Not a directory\).* UR_CLIENT_ROS2_CACHE"):
        ensure(cache=tmp_path / "file/cache")


def test_the_cache_is_where_the_environment_says(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("UR_CLIENT_ROS2_CACHE", raising=False)
    assert message_packages.default_cache() == tmp_path / "ur-client/ros2"
    monkeypatch.setenv("UR_CLIENT_ROS2_CACHE", str(tmp_path / "own"))
    assert message_packages.default_cache() == tmp_path / "own"


def test_a_distribution_without_definitions_is_refused(tmp_path, monkeypatch):
    folder = tmp_path / "lib/python3/site-packages/rclpy"
    folder.mkdir(parents=True)
    (folder / "__init__.py").touch()
    monkeypatch.delitem(sys.modules, "rclpy", raising=False)
    monkeypatch.setattr(sys, "path", [str(folder.parent), *sys.path])
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    monkeypatch.setenv("ROS_DISTRO", "galactic")
    with pytest.raises(Ros2Error, match="humble, jazzy, kilted and lyrical, but not for galactic"):
        message_packages.find_installation()
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert message_packages.find_installation() == Ros2Installation("humble", (tmp_path,), sourced=True)
    monkeypatch.delenv("ROS_DISTRO")  # only the setup.sh of message packages was sourced, for wheels
    monkeypatch.setattr(message_packages, "_installed", lambda name: name == "ros-jazzy-rclpy")
    assert message_packages.find_installation().distribution == "jazzy"


def in_ros(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A process of its own, since what is imported stays imported."""
    settings = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(1 + os.getpid() % 100)}
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)],
        capture_output=True,
        text=True,
        timeout=900,
        env={**os.environ, **settings, **environment},
    )


needs_ros = pytest.mark.skipif(
    not message_packages._importable("rclpy"), reason="ROS 2 is not installed: pip install '.[ros2]'"
)

ENSURE = "from client.ros2.message_packages import ensure; print(ensure().prefix)\n"


@needs_ros
def test_without_a_compiler_it_says_what_to_install(tmp_path):
    done = in_ros(ENSURE, UR_CLIENT_ROS2_CACHE=str(tmp_path), PATH=str(tmp_path))
    assert ": no compiler: none of cc, gcc, clang was found" in done.stderr
    assert "build-essential" in done.stderr


@needs_ros
def test_without_rosidl_it_says_what_to_install(tmp_path):
    (tmp_path / "rosidl_parser.py").write_text("raise ImportError('no rosidl')")
    done = in_ros(
        ENSURE, UR_CLIENT_ROS2_CACHE=str(tmp_path / "cache"), PYTHONPATH=f"{tmp_path}:{os.environ['PYTHONPATH']}"
    )
    assert ": rosidl's generators are not installed" in done.stderr


TEMPLATE = """@# comment
@{
total = 0
separator = "@"
}@
@@ @(len(names)) @total
@[for name in names]@
@[  if name == "skipped"]@
@[    continue]@
@[  elif name.startswith("a")]@
a: @(name)@(separator)
@[  else]@
other: @name @(None)
@[  end if]@
@{total += len(name)}@
@[end for]@
@[while total > 20]@
@{total -= 10}@
@[end while]@
@total@("!" if total else "")
"""


@needs_ros
def test_a_translated_template_writes_what_empy_writes(monkeypatch):
    em = pytest.importorskip("em")
    if not em.__version__.startswith("4."):
        pytest.skip("templates are translated for EmPy 4 only")

    def written(*names: str) -> str:
        output = io.StringIO()
        interpreter = em.Interpreter(config=em.Configuration(defaultStdout=output, rawErrors=True), dispatcher=False)
        interpreter.string(TEMPLATE, locals={"names": names})
        interpreter.shutdown()
        return output.getvalue()

    cases = [("abc", "skipped", "def"), (), ("a long name", "and another long name")]
    expected = [written(*names) for names in cases]
    monkeypatch.setattr(em.Interpreter, "string", em.Interpreter.string)
    rosidl._cache_templates()
    assert [written(*names) for names in cases] == expected
    assert "a: abc@" in expected[0]


SERVER = """
import rclpy
from rclpy.action import ActionServer
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.srv import SwitchController
from tf2_msgs.msg import TFMessage

rclpy.init()
node = rclpy.create_node("server")
frames = node.create_publisher(TFMessage, "frames", 1)

def execute(goal):
    goal.publish_feedback(FollowJointTrajectory.Feedback(joint_names=goal.request.trajectory.joint_names))
    goal.succeed()
    return FollowJointTrajectory.Result(error_code=FollowJointTrajectory.Result.GOAL_TOLERANCE_VIOLATED)

def switch(request, response):
    response.ok = request.strictness == request.STRICT and request.activate_controllers == ["a", "b"]
    return response

action = ActionServer(node, FollowJointTrajectory, "follow", execute)
service = node.create_service(SwitchController, "switch", switch)
print("ready", flush=True)
rclpy.spin(node)
"""

CLIENT = """
import os, signal, subprocess, sys
from client.ros2.message_packages import ensure
print(ensure().prefix, flush=True)
server = subprocess.Popen([sys.executable, "-c", os.environ["SERVER"]], stdout=subprocess.PIPE)
try:
    assert server.stdout.readline() == b"ready\\n"
    import rclpy
    from rclpy.action import ActionClient
    from control_msgs.action import FollowJointTrajectory
    from controller_manager_msgs.srv import SwitchController
    from trajectory_msgs.msg import JointTrajectory
    from ur_msgs.action import SendScript
    from ur_msgs.srv import SetForceMode

    force = SetForceMode.Request()  # what no type hash tells: constants, and values of what is not given
    print(force.type == force.NO_TRANSFORM, force.damping_factor, force.gain_scaling, force.deviation_limits[5])
    print(SendScript.Goal().fail_on_warnings)

    rclpy.init()
    node = rclpy.create_node("client")
    def done(future):
        rclpy.spin_until_future_complete(node, future, timeout_sec=30)
        return future.result()
    service = node.create_client(SwitchController, "switch")
    assert service.wait_for_service(30)
    print(done(service.call_async(SwitchController.Request(activate_controllers=["a", "b"], strictness=2))).ok)
    action = ActionClient(node, FollowJointTrajectory, "follow")
    assert action.wait_for_server(30)
    received = []
    goal = FollowJointTrajectory.Goal(trajectory=JointTrajectory(joint_names=["elbow_joint"]))
    accepted = done(action.send_goal_async(goal, feedback_callback=received.append))
    print(done(accepted.get_result_async()).result.error_code, received[0].feedback.joint_names)
finally:
    server.kill()
    server.wait()
"""


@needs_ros
@pytest.mark.timeout(900)  # the first time on a machine it compiles for a minute, longer if others do too
def test_two_nodes_talk_in_types_that_were_made_here():
    done = in_ros(CLIENT, SERVER=SERVER)
    assert done.returncode == 0, done.stderr
    prefix, force, warnings, switched, followed = done.stdout.splitlines()
    kind, *numbers = force.split()
    assert (kind, warnings) == ("True", "True")
    assert [float(number) for number in numbers] == pytest.approx([0.025, 0.5, 0.01])
    assert switched == "True"
    assert followed == "-5 ['elbow_joint']"
    if prefix != "None" and message_packages.find_installation().distribution != "humble":  # which has none
        check_hashes(Path(prefix))


def check_hashes(prefix: Path) -> None:
    """What rosidl compiled in, and so what the nodes tell others."""
    for name, digest in published()[message_packages.find_installation().distribution].items():
        package, kind, interface = name.split("/")
        description = json.loads((prefix / "share" / package / kind / f"{interface}.json").read_text())
        assert {"type_name": name, "hash_string": digest} in description["type_hashes"]
