"""A class in full: one fleet, its class page and as many browsers as robots, each then on the pendant of its own robot.

python benchmarks/class_page.py [robots]        # requires Chromium, and the extras pendant and test

All of it shares one machine here, including the browsers, which would otherwise be those of the students.
"""

import asyncio
import json
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from playwright.async_api import Page, async_playwright
from processes import cpu_s, memory_mib

_ROBOTS = 20
_SECONDS = 10.0
_PORT = 6070
_TIMEOUT_MS = 120_000
_FLAGS = ("--no-sandbox", "--disable-background-networking", "--disable-gpu")
_PROGRAM = (
    b"def wave():\n  while True:\n    movej([1, -1.5, 1, -1, -1, 0])\n    movej([0, -1.5, 1, -1, -1, 0])\n  end\nend\n"
)
# Two frames per second: without a graphics card, the processor draws all pages.
_SLOW_FRAMES = "window.requestAnimationFrame = callback => setTimeout(() => callback(performance.now()), 500);"
_COUNT_CHANGES = """seconds => new Promise(done => {
  let count = 0;
  new MutationObserver(() => count++).observe(document.querySelector("line:last-of-type"), { attributes: true });
  setTimeout(() => done(count), 1000 * seconds);
})"""


async def measure(count: int) -> None:
    """Print what each part of a class costs."""
    host = f"127.79.{os.getpid() % 250 + 1}.1"
    command = [sys.executable, "-u", "-m", "emulator", "fleet", "--model", "ur3", "--count", str(count), "--running"]
    command += [
        "--first-host",
        host,
        "--class-port",
        str(_PORT),
        "--ports-file",
        "ports.json",
        "--student-password",
        "s",
    ]
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
        fleet = await asyncio.create_subprocess_exec(
            *command, cwd=folder, env=environment, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        assert fleet.stdout is not None
        lines = list[str]()
        try:
            while not lines or not lines[-1].startswith("Ready"):
                lines.append((await fleet.stdout.readline()).decode())
            hosts = [row["host"] for row in json.loads(Path(folder, "ports.json").read_text())]
            for robot in hosts:
                _, writer = await asyncio.open_connection(robot, 30001)
                writer.write(_PROGRAM)
                await writer.drain()
            await _browse(fleet.pid, host, count)
        finally:
            fleet.terminate()
            rest = (await fleet.stdout.read()).decode()
        late = [line for line in rest.splitlines() if "late" in line]
        print("control periods:", late[-1] if late else "none reported late")


async def _browse(fleet: int, host: str, count: int) -> None:
    async with async_playwright() as playwright:
        browser = await playwright.chromium.launch(executable_path=shutil.which("chromium"), args=_FLAGS)
        contexts = [await browser.new_context() for _ in range(count)]
        for context in contexts:
            await context.add_init_script(_SLOW_FRAMES)
        pages = [await context.new_page() for context in contexts]
        began = time.monotonic()
        for page in pages:
            await _enter(page, host)
        print(f"{count} browsers show the class page after {time.monotonic() - began:.1f} s")
        page_process = next(pid for pid in _descendants(fleet) if b"spawn_main" in _arguments(pid))
        before = cpu_s(page_process)
        changes = await asyncio.gather(*(page.evaluate(_COUNT_CHANGES, _SECONDS) for page in pages))
        cost = (cpu_s(page_process) - before) / _SECONDS
        print(f"class page: {100 * cost:.0f} % of a core, {memory_mib(page_process):.0f} MiB")
        print(f"pictures per second in the slowest browser: {min(changes) / _SECONDS:.2f}")
        began = time.monotonic()
        for number, page in enumerate(pages, 1):
            await _open(page, host, number)
        print(f"{count} pendants were opened, one after the other, in {time.monotonic() - began:.0f} s")
        pendants = [pid for pid in _descendants(fleet) if b"--with-parent" in _arguments(pid)]
        before = sum(map(cpu_s, pendants))
        await asyncio.sleep(_SECONDS)
        cost = (sum(map(cpu_s, pendants)) - before) / _SECONDS
        print(f"{len(pendants)} pendants: {100 * cost:.0f} % of a core, {sum(map(memory_mib, pendants)):.0f} MiB")
        texts = [await page.locator(".robot-name").inner_text() for page in pages]
        assert len({re.findall(r"[\d.]+$", text)[0] for text in texts}) == count, texts
        await browser.close()


async def _enter(page: Page, host: str) -> None:
    page.set_default_timeout(_TIMEOUT_MS)
    await page.goto(f"http://{host}:{_PORT}/")
    await page.get_by_label("Password").fill("s")
    await page.get_by_role("button", name="Enter").click()
    await page.locator('li[data-mode="RUNNING"]').last.wait_for()


async def _open(page: Page, host: str, number: int) -> None:
    await page.goto(f"http://{host}:{_PORT}/robot/{number}")
    await page.locator('.robot-name:has-text("UR3")').wait_for()


def _descendants(pid: int) -> list[int]:
    children = [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return children + [other for child in children for other in _descendants(child)]


def _arguments(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


if __name__ == "__main__":
    asyncio.run(measure(int(sys.argv[1]) if len(sys.argv) > 1 else _ROBOTS))
