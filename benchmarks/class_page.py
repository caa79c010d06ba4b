"""A class in full: one fleet, its class page, and a session for each robot, which all open their pendant at once.

python benchmarks/class_page.py [robots]        # requires Chromium, and the extras pendant and test

All of it shares one machine here, including the browsers, which would otherwise be those of the students.
"""

import asyncio
import json
import os
import re
import shutil
import statistics
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from playwright.async_api import Browser, Page, async_playwright
from processes import cpu_s, family, shared_mib
from table import Table

from urproto.controlapi import ControlClient
from urproto.ports import CONTROL_API_PORT

_ROBOTS = 20
_SECONDS = 10.0
_PORT = 6070
_TIMEOUT_MS = 600_000
_SEE_OTHER = 303
_FLAGS = (
    *("--no-sandbox", "--disable-background-networking", "--disable-component-update", "--disable-extensions"),
    *("--disable-gpu", "--disable-software-rasterizer", "--in-process-gpu"),  # nothing is drawn in 3D
)
_PROGRAM = b"""def wave():
  while True:
    movej([1, -1.5, 1, -1, -1, 0])
    sleep(3)
    movej([0, -1.5, 1, -1, -1, 0])
    sleep(3)
  end
end
"""
# Two frames per second: without a graphics card, the processor draws all pages.
_SLOW_FRAMES = "window.requestAnimationFrame = callback => setTimeout(() => callback(performance.now()), 500);"
_COUNT_CHANGES = """([selector, seconds]) => new Promise(done => {
  let count = 0;
  const all = { attributes: true, characterData: true, childList: true, subtree: true };
  new MutationObserver(() => count++).observe(document.querySelector(selector), all);
  setTimeout(() => done(count), 1000 * seconds);
})"""
_MISSED = re.compile(r"^ur_emulator_periods(?:_missed)?_total (\d+)", re.MULTILINE)


def measure(robots: int = _ROBOTS) -> Table:
    """One row for each part of a class: what it costs, and whether it does its work meanwhile."""
    return asyncio.run(_measure(robots))


async def _measure(count: int) -> Table:
    host = f"127.79.{os.getpid() % 250 + 1}.1"
    command = [sys.executable, "-u", "-m", "emulator", "fleet", "--model", "ur3", "--count", str(count), "--running"]
    command += ["--first-host", host, "--class-port", str(_PORT), "--ports-file", "ports.json"]
    command += ["--student-password", "s"]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
        fleet = await asyncio.create_subprocess_exec(
            *command, cwd=folder, env=environment, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        assert fleet.stdout is not None
        line = b""
        try:
            while not line.startswith(b"Ready"):
                line = await fleet.stdout.readline()
            hosts = [row["host"] for row in json.loads(Path(folder, "ports.json").read_text())]
            for robot in hosts:
                _, writer = await asyncio.open_connection(robot, 30001)
                writer.write(_PROGRAM)
                await writer.drain()
                writer.close()
            return await _attend(fleet.pid, hosts)
        finally:
            fleet.terminate()
            await fleet.communicate()


async def _attend(fleet: int, hosts: list[str]) -> Table:
    """Open the class page and then the pendants in the browsers, look at them, and press a button in each."""
    async with async_playwright() as playwright:
        executable = shutil.which("chromium")
        browser = await playwright.chromium.launch(executable_path=executable, args=_FLAGS, timeout=_TIMEOUT_MS)
        pages = await asyncio.gather(*(_page(browser, hosts[0]) for _ in hosts))
        (page_process,) = (pid for pid in family(fleet) if b"spawn_main" in _arguments(pid))
        await pages[0].goto(f"http://{hosts[0]}:{_PORT}/")
        await pages[0].locator('li[data-mode="RUNNING"]').last.wait_for()
        (pictures,), page_cost = await _watched(pages[:1], "line:last-of-type", [[page_process]])
        before, began = _periods(hosts), time.monotonic()
        await asyncio.gather(*(_open(page, hosts, number) for number, page in enumerate(pages, 1)))
        opened_s = time.monotonic() - began
        pendants = [pid for pid in family(fleet) if b"--with-parent" in _arguments(pid)]
        workers = [pid for pid in family(fleet) if pid not in {page_process, *pendants}]
        browsers = [pid for pid in family(os.getpid()) if b"chrom" in _arguments(pid)]
        changes, costs = await _watched(pages, "body", [workers, pendants, browsers])
        pressed = await asyncio.gather(*(_press(page, robot) for page, robot in zip(pages, hosts, strict=True)))
        missed, periods = (now - then for now, then in zip(_periods(hosts), before, strict=True))
        results = (
            f"{missed} of {periods} periods missed",
            f"{sum(map(bool, changes))} of {len(hosts)} live, the slowest with {min(changes) / _SECONDS:.1f} changes/s",
            f"{len(pressed)} of {len(hosts)} stopped their robot, after {statistics.median(pressed):.1f} s in the "
            f"median, {max(pressed):.1f} s at most",
        )
        parts = zip(("robots", "pendants", "browsers"), (workers, pendants, browsers), costs, results, strict=True)
        rows = [[name, str(len(pids)), cost, _memory(pids), result] for name, pids, cost, result in parts]
        shown = f"{pictures / _SECONDS:.1f} changes/s"
        rows.insert(1, ["class page", "1", page_cost[0], _memory([page_process]), shown])
    note = (
        f"{len(hosts)} UR3 that move, and as many sessions of a headless Chromium on the same machine, each with the "
        "pendant of one robot, drawn at two frames per second. All pendants were opened at the same time and were "
        f"there after {opened_s:.0f} s; then Stop was pressed in all of them. Cost over {_SECONDS:g} s: of the class "
        "page while one browser shows it, otherwise while all show their pendant. Missed periods: from the first "
        "request for a pendant to the last press."
    )
    return Table("A class", note, ["part", "processes", "cost", "memory", "result"], rows)


async def _page(browser: Browser, host: str) -> Page:
    """An empty page of a student who knows the password, with nothing in common with the others but the process."""
    context = await browser.new_context()
    await context.add_init_script(_SLOW_FRAMES)
    answer = await context.request.post(f"http://{host}:{_PORT}/login", data={"password": "s"}, timeout=_TIMEOUT_MS)
    assert answer.ok, await answer.text()
    page = await context.new_page()
    page.set_default_timeout(_TIMEOUT_MS)
    return page


async def _open(page: Page, hosts: list[str], number: int) -> None:
    """Follow the link of a robot, and wait until its pendant shows it.

    The link is asked for beforehand: a browser without a window animates a page that loads, which takes a core.
    """
    link = f"http://{hosts[0]}:{_PORT}/robot/{number}"
    while (await page.context.request.get(link, max_redirects=0, timeout=_TIMEOUT_MS)).status != _SEE_OTHER:
        await asyncio.sleep(1.0)  # the pendant is still starting
    await page.goto(link)
    await page.locator(f'.robot-name:has-text("{hosts[number - 1]}")').wait_for()


async def _watched(pages: list[Page], selector: str, groups: list[list[int]]) -> tuple[list[int], list[str]]:
    """How often an element of each page changes meanwhile, and what each group of processes costs."""
    before, began = [{pid: cpu_s(pid) for pid in pids if _runs(pid)} for pids in groups], time.monotonic()
    changes = await asyncio.gather(*(page.evaluate(_COUNT_CHANGES, [selector, _SECONDS]) for page in pages))
    seconds = time.monotonic() - began
    used = (sum(cpu_s(pid) - cpu for pid, cpu in then.items() if _runs(pid)) for then in before)
    return changes, [f"{100 * cpu / seconds:.0f} %" for cpu in used]


async def _press(page: Page, host: str) -> float:
    """Press Stop; the time until the robot's program has ended [s]."""
    condition = {"condition": "runtime_state == STOPPED", "timeout_s": 60.0}
    stopped = asyncio.create_task(asyncio.to_thread(ControlClient(host).call, "run_until", condition))
    await asyncio.sleep(1.0)  # until all requests have begun
    began = time.monotonic()
    await page.get_by_test_id("stop").click(force=True)
    await stopped
    return time.monotonic() - began


def _periods(hosts: list[str]) -> tuple[int, int]:
    """Control periods of all robots: missed, and all."""
    found = {"missed": 0, "all": 0}
    for host in hosts:
        with urllib.request.urlopen(f"http://{host}:{CONTROL_API_PORT}/metrics") as response:
            for match in _MISSED.finditer(response.read().decode()):
                found["missed" if "missed" in match[0] else "all"] += int(match[1])
    return found["missed"], found["all"]


def _memory(pids: list[int]) -> str:
    return f"{sum(map(shared_mib, filter(_runs, pids))):.0f} MiB"


def _runs(pid: int) -> bool:
    """Whether a process has not ended: browsers replace some of theirs."""
    return Path(f"/proc/{pid}/smaps_rollup").exists()


def _arguments(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes() if _runs(pid) else b""


if __name__ == "__main__":
    sys.stdout.write(measure(int(sys.argv[1]) if len(sys.argv) > 1 else _ROBOTS).markdown())
