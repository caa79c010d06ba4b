"""The cost of the teach pendant, and its effect on the control loop, with and without a browser.

Without a graphics card, the browser renders in software, which takes far more CPU time than the pendant. It is a
separate process, usually on another computer.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext

import jitter
from processes import cpu_s, memory_mib
from table import Table

SECONDS = 30.0
_FLAGS = ("--no-sandbox", "--disable-background-networking", "--use-gl=angle", "--use-angle=swiftshader")
_PROGRAM = b"""def back_and_forth():
  while True:
    movej([0.5, -1.2, 0.4, -1.0, 0.3, 0.3])
    movej([-0.5, -1.8, -0.4, -2.0, -0.3, -0.3])
  end
end
"""


def measure(seconds: float = SECONDS) -> Table:
    """One row for each arm and what looks at it while it moves."""
    rows = []
    for number, model in enumerate(("ur3", "ur5e"), 1):
        for what in ("nothing", "pendant", "pendant and browser"):
            rows.append([model, what, *_run(model, f"127.78.{os.getpid() % 250 + 1}.{number}", what, seconds)])
    note = (
        f"The arm moves for {seconds:g} s; the browser shows the Move screen. Cost and memory: of the pendant's "
        "process. Lateness and missed periods: of the emulator's control loop."
    )
    columns = ["arm", "with", "cost", "memory", "p50", "p99", "p99.9", "worst", "missed", "collector"]
    return Table("Teach pendant", note, columns, rows)


def _run(model: str, host: str, what: str, seconds: float) -> list[str]:
    command = [sys.executable, __file__, "serve", model, host]
    serve = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert serve.stdout is not None
    json.loads(serve.stdout.readline())
    pendant = _pendant(host) if what != "nothing" else nullcontext(0)
    browser = _browser(host) if "browser" in what else nullcontext()
    with socket.create_connection((host, 30001)) as primary, pendant as pid, browser:
        primary.sendall(_PROGRAM)
        cost = _cost(pid, seconds)
    return [*cost, *jitter.result(serve)]


def _cost(pid: int, seconds: float) -> list[str]:
    if not pid:
        time.sleep(seconds)
        return ["", ""]
    before = cpu_s(pid)
    time.sleep(seconds)
    return [f"{100 * (cpu_s(pid) - before) / seconds:.1f} %", f"{memory_mib(pid):.0f} MiB"]


@contextmanager
def _pendant(host: str) -> Iterator[int]:
    command = [sys.executable, "-u", "-m", "client", "pendant", "--robot-ip", host, "--host", host, "--with-parent"]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdin is not None
    process.stdout.readline()
    time.sleep(1.0)  # imports are not what is measured
    yield process.pid
    process.stdin.close()
    process.wait()


@contextmanager
def _browser(host: str) -> Iterator[None]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(f"http://{host}:6080/move")
        page.wait_for_timeout(3000)  # loading is not what is measured
        yield
        browser.close()


def main(arguments: Sequence[str]) -> None:
    """Measure, or be one of the measured processes."""
    match arguments:
        case ["serve", model, host]:
            jitter.serve_at(model, host)
        case [seconds]:
            sys.stdout.write(measure(float(seconds)).markdown())
        case _:
            sys.stdout.write(measure().markdown())


if __name__ == "__main__":
    main(sys.argv[1:])
