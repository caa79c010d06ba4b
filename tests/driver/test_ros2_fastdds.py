"""The ROS 2 bridge against Fast DDS, which most nodes of ROS 2 use: Debian's packages, a program of its own."""

import math
import shutil
import subprocess
from pathlib import Path

import pytest
from driver_rig import HOME
from ros2_rig import SCALED, bridged, free_domain, process

from client.controllers import JOINT_NAMES
from urproto.robots import load_model
from urproto.robots.description import urdf

SOURCES = Path(__file__).with_name("fastdds")
PACKAGES = "apt-get install g++ fastddsgen libfastrtps-dev (Debian 12: Fast DDS 2.9)"
HEADERS = "#include <fastdds/dds/domain/DomainParticipant.hpp>\n#include <fastrtps/utils/IPLocator.h>\n"
pytestmark = pytest.mark.timeout(600)  # compiling takes ten seconds, on a busy machine more


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The program, built of its types and its source."""
    if missing := [name for name in ("g++", "fastddsgen") if shutil.which(name) is None]:
        pytest.skip(f"{missing[0]} is not installed: {PACKAGES}")
    if run("g++", "-std=c++17", "-fsyntax-only", "-x", "c++", "-", text=HEADERS).returncode:
        pytest.skip(f"Fast DDS 2 is not installed: {PACKAGES}")
    folder = tmp_path_factory.mktemp("fastdds")
    for source in SOURCES.iterdir():
        shutil.copy(source, folder)
    run("fastddsgen", "-replace", "Ros.idl", folder=folder).check_returncode()
    sources = ("peer.cpp", "Ros.cxx", "RosPubSubTypes.cxx")
    built = run("g++", "-std=c++17", "-w", "-o", "peer", *sources, "-lfastrtps", "-lfastcdr", folder=folder)
    assert built.returncode == 0, built.stderr
    return str(folder / "peer")


def run(*words, folder=None, text=""):
    return subprocess.run(words, cwd=folder, input=text, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("robot", ["ur5e"], indirect=True)
async def test_both_ways(robot, program, capfd):
    with free_domain() as domain:
        async with bridged(robot, domain, SCALED) as lab:
            async with process(program, str(domain)) as peer:
                await hears(lab, peer)
                there = [q + 0.1 for q in HOME]
                await goes(lab, peer, there)
            async with process(program, str(domain)) as stranger:  # and whoever comes late hears what is kept
                assert await stranger.line("robot_description") == f"robot_description {len(urdf(load_model('ur5e')))}"
                errors = ""

                def complained():
                    nonlocal errors
                    errors += capfd.readouterr().err
                    return f"deserialization rt/{SCALED}/joint_trajectory" in errors  # CycloneDDS's own words

                await again(lab, lambda: stranger.line("garbage"), "garbage", complained)
                assert (await stranger.line("joint_states")).startswith("joint_states ")
            assert lab.distance(there) < 0.005
            async with process(program, str(domain)) as third:
                await goes(lab, third, HOME)


async def goes(lab, peer, there):
    """A trajectory arrives, and the arm does too."""
    trajectory = "go 0.7 " + " ".join(map(str, there))
    controller = lab.controller(SCALED)

    def moves():  # or it has moved already, where the answer took long
        return controller.progress < 1.0 or lab.distance(there) < 0.005

    await again(lab, lambda: peer.line(trajectory), "go", moves)
    await lab.until(lambda: lab.distance(there) < 0.005)


async def again(lab, say, answer, arrived):
    """Say it until it has arrived.

    What a writer of Fast DDS sends in the moment in which it finds a volatile reader of CycloneDDS is lost more often
    than not: the reader begins behind the first heartbeat it hears.
    """
    for _ in range(20):
        assert await say() == answer
        for _ in range(10):
            await lab.periods(20)
            if arrived():
                return
    raise AssertionError(f"{answer} never arrived")


async def hears(lab, peer):
    """What is told arrives, with its values."""
    _, seconds, *joints = (await peer.line("joint_states")).split()
    assert float(seconds) > 1e9
    assert joints[::4] == list(JOINT_NAMES)
    assert [float(q) for q in joints[1::4]] == pytest.approx(lab.q, abs=1e-3)
    assert float((await peer.line("speed_scaling")).split()[1]) == pytest.approx(100.0)
    assert "base_link>base 0 0 0 0 0 1" in await peer.line("tf_static")
    frames: dict[str, list[float]] = {}
    while "base_link_inertia>shoulder_link" not in frames:
        words = (await peer.line("tf")).split()[1:]
        frames |= {name: list(map(float, words[i + 1 : i + 8])) for i, name in enumerate(words) if ">" in name}
    *_, turn, w = frames["base_link_inertia>shoulder_link"]
    assert 2.0 * math.atan2(turn, w) == pytest.approx(HOME[0], abs=1e-3)
