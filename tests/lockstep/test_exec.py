"""``ur-emulator exec``: programs that nobody changed, in time of their own."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from emulator.config import ConfigError
from emulator.lockstep.clock import SharedClock, check_program
from urproto.testing.process import claim_address

if sys.platform != "linux":
    pytest.skip("the shared clock is a library for Linux", allow_module_level=True)

LIMIT_S = 300.0  # of real time, for what takes seconds: only a clock that stands still reaches it
SERVO = Path(__file__).resolve().parents[2] / "benchmarks" / "ur_rtde_servo.py"


def run(*command: str, options: tuple[str, ...] = ("--without-robot",)) -> "subprocess.CompletedProcess[str]":
    whole = [sys.executable, "-m", "emulator", "exec", *options, "--", *command]
    return subprocess.run(whole, capture_output=True, text=True, timeout=LIMIT_S, check=False)


PROGRAMS = {  # name: seconds that pass in it, and its text
    "sleep": (86_400, "time.sleep(86400)"),
    "event loop": (3600, "asyncio.run(asyncio.sleep(3600))"),
    "select": (600, "select.select([], [], [], 600)"),
    "lock": (500, "threading.Event().wait(500)"),
    "threads": (
        700,
        "threads = [threading.Thread(target=time.sleep, args=(s,)) for s in (300, 700)]\n"
        "[t.start() for t in threads]\n[t.join() for t in threads]",
    ),
    "socket": (30, "a, b = socket.socketpair()\na.settimeout(30)\ntry: a.recv(1)\nexcept TimeoutError: pass"),
    "child": (20, "subprocess.run([sys.executable, '-c', 'import time; time.sleep(20)'], check=True)"),
    "shell": (40, "subprocess.run('sleep 30 & sleep 40; wait', shell=True, check=True)"),
    "killed": (
        20,
        "assert {subprocess.run(['sh', '-c', 'kill -9 $$']).returncode for _ in range(200)} == {-9}\ntime.sleep(20)",
    ),
    "kills": (
        10,
        "sleeper = threading.Thread(target=time.sleep, args=(10,))\nsleeper.start()\n"
        "for _ in range(20):\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'print(flush=True); import time; time.sleep(1e6)'],\n"
        "                             stdout=subprocess.PIPE)\n"
        "    child.stdout.readline()\n    child.kill()\n    child.wait()\n    child.stdout.close()\n"
        "assert time.monotonic() < began + 1\nsleeper.join()",
    ),
    "looks at the clock only": (5, "while time.monotonic() < began + 5: pass"),
    "polls": (
        9,
        "threading.Thread(target=time.sleep, args=(9,)).start()\nwhile threading.active_count() > 1: time.sleep(0.001)",
    ),
    "waits in an unknown way, twice": (
        10_000.4,
        "def locked():\n"
        "    files = [open(sys.executable) for _ in range(2)]\n"
        "    fcntl.flock(files[0], fcntl.LOCK_SH)\n"
        "    other = threading.Thread(target=fcntl.flock, args=(files[1], fcntl.LOCK_EX))\n"
        "    other.start()\n"
        "    time.sleep(0.2)\n"
        "    files[0].close()\n"
        "    other.join()\n"
        "locked()\ntime.sleep(10_000)\nlocked()",
    ),
    "only sends": (
        0.05,
        "server = socket.create_server(('127.0.0.1', 0))\n"
        "peer = socket.create_connection(server.getsockname())\n"
        "threading.Timer(0.05, peer.shutdown, (socket.SHUT_RDWR,)).start()\n"
        "try:\n    while True: peer.send(b'x')\nexcept OSError: pass",
    ),
}


def test_time_passes_only_while_all_wait() -> None:
    text = "import asyncio, fcntl, select, socket, subprocess, sys, threading, time\n"
    for name, (_, program) in PROGRAMS.items():
        text += f"began = time.monotonic()\n{program}\nprint({name!r}, time.monotonic() - began, sep=': ')\n"
    done = run(sys.executable, "-c", text)
    assert done.returncode == 0, done.stderr
    measured = {name: float(took) for name, took in (line.split(": ") for line in done.stdout.splitlines())}
    assert measured == pytest.approx({name: seconds for name, (seconds, _) in PROGRAMS.items()}, rel=0.003, abs=0.02)


def test_programs_exchange_messages_without_losing_time() -> None:
    """A thousand messages and answers between two processes take no time; each pause takes what it says."""
    text = """
import socket, subprocess, sys, time
if len(sys.argv) > 1:
    peer = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    while data := peer.recv(64):
        time.sleep(0.01)
        peer.sendall(data)
else:
    with socket.create_server(("127.0.0.1", 0)) as server:
        child = subprocess.Popen([sys.executable, sys.orig_argv[-1], str(server.getsockname()[1])])
        peer, _ = server.accept()
        began = time.monotonic()
        for n in range(1000):
            peer.sendall(b"%d" % n)
            assert peer.recv(64) == b"%d" % n
        print(round(time.monotonic() - began, 6))
        peer.close()
        child.wait()
"""
    file = Path(os.environ["TMPDIR"], "exchange.py")
    file.write_text(text)
    done = run(sys.executable, str(file))
    assert (done.returncode, done.stderr) == (0, "")
    assert float(done.stdout) == pytest.approx(10.0, abs=0.001)


def test_a_thread_that_wakes_another_goes_on_until_it_waits() -> None:
    """All share one core: the woken one would otherwise run in the middle of what the first does, every third time."""
    text = """
import mmap, os, socket
done = mmap.mmap(-1, 8)
here, there = socket.socketpair()
if child := os.fork():
    for n in range(1, 1001):
        here.send(b"x")
        done[:8] = n.to_bytes(8, "little")
        here.recv(1)
    os.waitpid(child, 0)
else:
    early = 0
    for n in range(1, 1001):
        there.recv(1)
        early += int.from_bytes(done[:8], "little") < n
        there.send(b"x")
    print(early)
"""
    done = run(sys.executable, "-c", text)
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) < 150  # only when its time on a busy core was over


LIBRARY = """
#include <pthread.h>
#include <time.h>

static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t condition = PTHREAD_COND_INITIALIZER;

static void *wait_a_second(void *unused)
{
    struct timespec until;
    clock_gettime(CLOCK_REALTIME, &until);
    until.tv_sec++;
    pthread_mutex_lock(&mutex);
    pthread_cond_timedwait(&condition, &mutex, &until);
    pthread_mutex_unlock(&mutex);
    return unused;
}

__attribute__((constructor)) static void begin(void)
{
    pthread_t thread;
    pthread_create(&thread, NULL, wait_a_second, NULL);
    nanosleep(&(struct timespec){0, 100000000}, NULL); /* until it waits */
}
"""


def test_a_library_that_begins_threads_while_it_is_loaded(tmp_path: Path) -> None:
    """As jemalloc does in PyArrow: meanwhile the loader keeps its lock, for which nothing of ours may wait."""
    (tmp_path / "library.c").write_text(LIBRARY)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", "library.so", "library.c", "-lpthread"], cwd=tmp_path, check=True)
    text = f"import ctypes, time; ctypes.CDLL({str(tmp_path / 'library.so')!r}); time.sleep(5); print('loaded')"
    done = run(sys.executable, "-c", text)
    assert (done.returncode, done.stdout, done.stderr) == (0, "loaded\n", "")


def test_ur_rtde_streams_in_lockstep_the_same_each_time() -> None:
    """1,000 servoJ of the unmodified library take eight seconds for both sides, and each run is the same."""
    pytest.importorskip("rtde_control")
    address = claim_address()
    try:
        options = ("--model", "ur3", "--host", address.host)
        outputs = [run(sys.executable, str(SERVO), address.host, "1000", options=options) for _ in range(2)]
    finally:
        address.release()
    assert [done.returncode for done in outputs] == [0, 0], outputs
    client_s, robot_s, *_, lag = map(float, outputs[0].stdout.split())
    assert client_s == pytest.approx(robot_s, abs=0.02)
    assert robot_s == pytest.approx(1000 * 0.008, rel=0.02)
    # its threads race within a moment, so that one of the states that it looks at may be the one before
    assert [float(done.stdout.split()[-1]) for done in outputs] == [lag, lag]


def test_the_speed_is_limited_on_request() -> None:
    began = time.monotonic()
    done = run(sys.executable, "-c", "import time; time.sleep(60)", options=("--without-robot", "--speed", "60"))
    assert done.returncode == 0
    assert time.monotonic() - began >= 1.0


def test_status_and_signals_pass_through() -> None:
    assert run("sh", "-c", "exit 7").returncode == 7
    assert run("sh", "-c", "kill -9 $$").returncode == 128 + 9
    command = [sys.executable, "-m", "emulator", "exec", "--without-robot", "--", "sh", "-c", "echo up; read line"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 128 + signal.SIGTERM


def test_programs_without_the_clock_are_refused(tmp_path: Path) -> None:
    go = tmp_path / "go"
    go.write_bytes(Path("/bin/true").read_bytes() + b"\xff Go buildinf:")
    static = tmp_path / "static"
    header = bytearray(Path("/bin/true").read_bytes()[:64])
    header[56:58] = b"\0\0"  # no program headers, so no interpreter
    static.write_bytes(header)
    for path in (go, static):
        path.chmod(0o755)
    for name, reason in (("no-such-program", "no program"), (str(go), "Go program"), (str(static), "statically")):
        with pytest.raises(ConfigError, match=reason):
            check_program(name)
    with pytest.raises(ConfigError, match="positive"):
        SharedClock(0.0)
