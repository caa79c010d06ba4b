"""Physics: a control period compared with bare ``mj_step``, real time with a camera, and Gymnasium."""

import asyncio
import json
import os
import runpy
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from http.client import HTTPConnection
from math import pi
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from processes import cpu_s
from table import Table

from emulator.app import Emulator
from emulator.clock import ClockStatistics, RealClock
from emulator.commands.requests import ScriptUnit
from emulator.config import EmulatorConfig, controller_config
from emulator.controller import Controller
from emulator.physics.world import PhysicsWorld
from emulator.realtime import claim_real_time, freeze_heap

BODIES = (1, 10, 50)
BLOCK = 250  # control periods
ROUNDS = 12
HOME = (0.0, -1.5, 1.5, -pi / 2, -pi / 2, 0.0)
SWING = """def swing():
  while True:
    movej([0.4, -1.7, 1.5, -1.4, -1.57, 0.0], a=1.4, v=1.05)
    movej([-0.4, -1.5, 1.3, -1.4, -1.57, 0.3], a=1.4, v=1.05)
  end
end
"""
SECONDS = 20.0
CAMERA_HZ = 10
_SETTLE_S = 3.0  # the first periods, and the first picture, pay for first-time costs
EPISODES = 6
STEPS = 250  # of an episode with random actions, 10 s of robot time
_POLICY = Path(__file__).resolve().parents[1] / "examples" / "learning" / "scripted_policies.py"


def measure() -> Table:
    """One row for each number of bodies."""
    rows = []
    for count in BODIES:
        with scene(count) as path:
            resting, moving, without = _robot(path), _robot(path, SWING), _robot(None, SWING)
        least = interleaved(
            {"rest": resting.tick, "moving": moving.tick, "without": without.tick, "bare": bare_steps(moving)}
        )
        ratio = (least["moving"] - least["without"]) / least["bare"]
        shown = [f"{1e6 * least[name]:.0f} us" for name in ("rest", "moving", "without", "bare")]
        rows.append(["one body" if count == 1 else f"bodies: {count}", *shown, f"{ratio:.2f}"])
    note = (
        f"CPU time of a control period of a UR5 (8 ms) in virtual time: minimum of {ROUNDS} alternating blocks of "
        f"{BLOCK} periods. The bodies are boxes on a table, and the arm moves above them. Bare: the `mj_step` calls of "
        "one period with the same scene, and nothing else. Ratio: what physics adds to the moving arm's period, "
        "relative to bare."
    )
    columns = ["scene", "at rest", "moving", "moving, no physics", "bare mj_step", "ratio"]
    return Table("Physics", note, columns, rows)


def interleaved(cases: Mapping[str, Callable[[], object]]) -> dict[str, float]:
    """Minimum CPU time of one call of each case [s], over alternating blocks."""
    least = dict.fromkeys(cases, float("inf"))
    for _ in range(ROUNDS):
        for name, call in cases.items():
            began = time.process_time()
            for _ in range(BLOCK):
                call()
            least[name] = min(least[name], (time.process_time() - began) / BLOCK)
    return least


def bare_steps(controller: Controller) -> Callable[[], None]:
    """The steps of one period of a robot's scene as it is now, but standing, with nothing around them."""
    world = controller.world
    assert isinstance(world, PhysicsWorld)
    model, data = world.model, mujoco.MjData(world.model)
    kind = mujoco.mjtState.mjSTATE_INTEGRATION
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, world.data, state, kind)
    mujoco.mj_setState(model, data, state, kind)
    data.qvel[:] = 0.0  # else the arm would fly away, and there would be less to look at
    return lambda: mujoco.mj_step(model, data, nstep=world.scene.steps)


def _robot(path: Path | None, script: str = "") -> Controller:
    """A UR5 whose scene has come to rest, and which moves if a script says so."""
    config = controller_config("ur5", world=path, physics=path is not None, running=True, initial_q=HOME)
    controller = Controller(config)
    if script:
        controller.post(ScriptUnit(script, "block"))
    for _ in range(BLOCK):
        controller.tick()
    if script and not controller.snapshot.program_running:
        raise RuntimeError(f"the program does not run: {list(controller.messages.history)[-3:]}")
    return controller


@contextmanager
def scene(bodies: int) -> Iterator[Path]:
    """A world file: boxes on a table before the arm, and a camera."""
    places = [(-0.3 - 0.06 * (i // 10), -0.27 + 0.06 * (i % 10)) for i in range(bodies)]
    boxes = [
        f"  box{i}: {{box: [0.04, 0.04, 0.04], pose: [{x:.2f}, {y:.2f}, 0.0201], mass: 0.1}}\n"
        for i, (x, y) in enumerate(places)
    ]
    text = (
        "objects:\n  table: {box: [1.6, 1.6, 0.1], pose: [0, 0, -0.05], friction: 0.6}\n"
        + "".join(boxes)
        + "cameras:\n  overview: {pose: [0.3, -1.1, 0.8], at: [-0.4, -0.15, 0.05], size: [320, 240]}\n"
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "cell.yaml")
        path.write_text(text)
        yield path


# real time, with a camera


def measure_real_time(seconds: float = SECONDS) -> Table:
    """20 bodies at 125 Hz, without and with somebody who looks, everything on one core."""
    with scene(20) as path:
        rows = [_real_time(path, looks, seconds) for looks in (False, True)]
    note = (
        f"A UR5 at 125 Hz over {seconds:g} s of real time whose arm moves above 20 boxes, on one core together with "
        f"the rendering process. Streamed: a client streams a camera of 320x240 pixels at {CAMERA_HZ} Hz."
    )
    columns = ["camera", "p50", "p99", "p99.9", "worst", "missed", "pictures per second", "robot", "rendering"]
    return Table("Physics and a camera on one core", note, columns, rows)


def _real_time(path: Path, looks: bool, seconds: float) -> list[str]:
    command = [sys.executable, __file__, "serve", str(path)]
    core = max(os.sched_getaffinity(0))
    server = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )
    assert server.stdin is not None
    assert server.stdout is not None
    port = json.loads(server.stdout.readline())
    pictures = _Stream(port) if looks else None
    _watch(pictures, _SETTLE_S)
    robot, drawing = cpu_s(server.pid), sum(map(cpu_s, _children(server.pid)))
    server.stdin.write("from now on\n")
    server.stdin.flush()
    shown = _watch(pictures, seconds)
    robot, drawing = cpu_s(server.pid) - robot, sum(map(cpu_s, _children(server.pid))) - drawing
    out, _ = server.communicate()
    row: list[str] = json.loads(out.splitlines()[-1])
    shares = [f"{robot / seconds:.1%}", f"{drawing / seconds:.1%}" if looks else ""]
    return ["streamed" if looks else "not used", *row, f"{shown / seconds:.1f}" if looks else "", *shares]


class _Stream:
    """Reads the parts of a stream of pictures."""

    def __init__(self, port: int) -> None:
        connection = HTTPConnection("127.0.0.1", port, timeout=60.0)
        connection.request("GET", f"/cameras/overview/rgb.mjpeg?fps={CAMERA_HZ}")
        self._response = connection.getresponse()
        if self._response.status != 200:
            raise RuntimeError(self._response.read().decode())

    def picture(self) -> None:
        """Wait for the next one."""
        length = 0
        while (line := self._response.readline()) != b"\r\n" or not length:
            if not line:
                raise RuntimeError("the stream of pictures ended")
            name, _, value = line.partition(b":")
            length = int(value) if name.lower() == b"content-length" else length
        self._response.read(length)


def _watch(pictures: _Stream | None, seconds: float) -> int:
    """How many pictures came in this time."""
    if pictures is None:
        time.sleep(seconds)
        return 0
    count, until = 0, time.monotonic() + seconds
    while time.monotonic() < until:
        pictures.picture()
        count += 1
    return count


def _children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


async def _serve(path: Path) -> None:
    """An emulator until its standard input ends; the first line of that begins the measuring."""
    config = controller_config("ur5", world=path, physics=True, running=True, initial_q=HOME)
    emulator = Emulator(EmulatorConfig(controller=config, ephemeral_ports=True))
    claim_real_time()
    lines: asyncio.Queue[str] = asyncio.Queue()
    async with emulator:
        asyncio.get_running_loop().add_reader(sys.stdin, lambda: lines.put_nowait(sys.stdin.readline()))
        emulator.controller.post(ScriptUnit(SWING, "block"))
        assert isinstance(emulator.clock, RealClock)
        freeze_heap()
        _say(emulator.ports["cameras"])
        while await lines.get():
            emulator.clock.statistics = ClockStatistics()
        statistics = emulator.clock.statistics
    late = [f"{1e3 * statistics.lateness_s(share):.2f} ms" for share in (0.5, 0.99, 0.999)]
    _say([*late, f"{statistics.latest_ns / 1e6:.2f} ms", f"{statistics.missed} of {statistics.ticks}"])


def _say(value: object) -> None:
    sys.stdout.write(json.dumps(value) + "\n")
    sys.stdout.flush()


# a learner's pace


def measure_learning() -> Table:
    """Robot seconds of PickAndPlace per second of CPU time, compared with MuJoCo alone."""
    rows = []
    for name in ("random", "scripted"):
        env = gymnasium.make("emulator.learning:ur_emulator/PickAndPlace-v1")
        env.reset(seed=0)
        task: Any = env.unwrapped
        bare = bare_steps(task.robot.controller)
        paces = [(_pace(env, name, seed), _bare_pace(bare, task.robot.controller.period_s)) for seed in range(EPISODES)]
        pace, alone = (max(values) for values in zip(*paces, strict=True))
        env.close()
        rows.append([name, f"{pace:.1f}", f"{alone:.1f}", f"{pace / alone:.2f}"])
    count = os.cpu_count() or 1
    rows.append([f"random, in {count} processes", f"{_vector_pace(count):.1f}", "", ""])
    note = (
        f"Robot seconds of ur_emulator/PickAndPlace-v1 (125 Hz, no cameras) per second of CPU time: best of {EPISODES} "
        "episodes including their resets. Actions are random, or those of the example's scripted policy. Bare: "
        "`mj_step` of its scene at rest, and nothing else, between the episodes. In processes: a vector environment "
        "with one process per core, per second of real time. Requirement: 60."
    )
    return Table("Gymnasium", note, ["actions", "robot s/s", "bare robot s/s", "share"], rows)


def _pace(env: "gymnasium.Env[Any, Any]", actions: str, seed: int) -> float:
    policy = runpy.run_path(str(_POLICY))["PickAndPlace"](env)
    steps, over, began = 0, False, time.process_time()
    seen, _ = env.reset(seed=seed)
    while not over:
        action = env.action_space.sample() if actions == "random" else policy(seen)
        seen, _, ended, late, _ = env.step(action)
        steps, over = steps + 1, ended or late
    step_s: float = env.unwrapped.step_s  # type: ignore[attr-defined]
    return steps * step_s / (time.process_time() - began)


def _vector_pace(count: int) -> float:
    """Robot seconds per second of real time of all environments together."""
    envs = gymnasium.make_vec(
        "emulator.learning:ur_emulator/PickAndPlace-v1",
        num_envs=count,
        vectorization_mode="async",
        vector_kwargs={"context": "spawn"},
    )
    try:
        envs.reset(seed=0)
        (step_s,) = set(envs.get_attr("step_s"))
        paces = []
        for _ in range(EPISODES):
            began = time.monotonic()
            for _ in range(STEPS):
                envs.step(envs.action_space.sample())
            paces.append(count * STEPS * step_s / (time.monotonic() - began))
        return max(paces)
    finally:
        envs.close()


def _bare_pace(period: Callable[[], None], period_s: float) -> float:
    began = time.process_time()
    for _ in range(BLOCK):
        period()
    return BLOCK * period_s / (time.process_time() - began)


def main() -> None:
    """The emulator of a measurement, or all of them."""
    if sys.argv[1:2] == ["serve"]:
        asyncio.run(_serve(Path(sys.argv[2])))
    else:
        for table in (measure(), measure_learning(), measure_real_time()):
            sys.stdout.write(table.markdown() + "\n")


if __name__ == "__main__":
    main()
