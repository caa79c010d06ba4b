"""Commands and programs in the documentation are run, in the order of each page and in the stated place.

They are run as a stranger runs them (`stranger.py`): in a fresh clone, without privileges, with only those packages
that the page says to install. Each page has a separate network, in which the robots it requires are emulators at the
addresses it names, and the usual ports are free. The network has no access to the outside, so blocks that fetch
packages are not run.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from tests.rows import each_row
from urproto.compat import load_toml

sys.path.insert(0, str(Path(__file__).parent))  # the helper next to this file; importlib mode does not add its folder

from pages import LANGUAGES, PAGES, ROOT, Block, blocks, indented, robots
from stranger import UNPRIVILEGED, clone, environment, move_in

ELSEWHERE = {
    ROOT / "docs" / "thesis.md": {"sh", "shell", "python", "ros"},  # tests/driver/test_thesis_page.py
    ROOT / "docs" / "client.md": {"python"},  # tests/real_clients/test_examples.py
}
DEADLINE_S = 120.0
NAMESPACE = """
import fcntl, os, socket, struct, sys, time
socket_ = socket.socket()
for number, host in enumerate(["127.0.0.1", *sys.argv[1:]]):
    name = b"lo" if number == 0 else b"lo:%d" % number
    if number:
        fcntl.ioctl(socket_, 0x8916, struct.pack("16sH2s4s8x", name, socket.AF_INET, b"", socket.inet_aton(host)))
    flags = struct.unpack("16sH14x", fcntl.ioctl(socket_, 0x8913, struct.pack("16sH14x", name, 0)))[1]
    fcntl.ioctl(socket_, 0x8914, struct.pack("16sH14x", name, flags | 1))
print("up", flush=True)
time.sleep(1e6)
"""  # the loopback interface with further addresses: SIOCSIFADDR, SIOCGIFFLAGS, SIOCSIFFLAGS


def runs(page: Path) -> list[Block]:
    """The blocks of a page that are run here."""
    done_elsewhere = ELSEWHERE.get(page, set())
    return [block for block in blocks(page) if not block.reason and block.language not in done_elsewhere]


def is_done(block: Block) -> bool:
    return bool(block.file) or block.language in ("sh", "shell", "python")


READY = ("Ready:", "Ctrl-C ends it", "Teach pendant of", " active")  # output of commands once they are ready
RUN = [page for page in PAGES if any(map(is_done, runs(page)))]
# pages that most people follow; the others are typed every night
OFTEN = {"README", "testing", "client", "journal", "checking", "script_tests", "explore", "debugging"}


@each_row("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_names_its_language(page: Path) -> None:
    assert not indented(page), f"{page.name}: code in lines {indented(page)} has no fence"
    assert page.read_text().count("\n```") + page.read_text().startswith("```") == 2 * len(blocks(page))
    hosts = [robot.host for robot in robots(page)]
    assert len(hosts) == len(set(hosts)), f"{page.name}: a robot is there for the whole page: name each once"
    for block in blocks(page):
        assert block.language in LANGUAGES, f"{block.place}: {block.language!r} is not a language of ours"
        if block.note:
            known = block.reason or block.file or block.stays or block.note.startswith("robot: ")
            assert known, f"{block.place}: what is {block.note!r}?"
        if block.language == "yaml":
            yaml.safe_load(block.code)
        if block.language == "toml":
            load_toml(block.code)
        if block.language == "python":
            compile(block.code, block.place, "exec", flags=0x2000)  # ast.PyCF_ALLOW_TOP_LEVEL_AWAIT


def test_installed_packages_and_extras_exist() -> None:
    """From a copy of the repository, as the package is on no index; with existing extras."""
    extras = load_toml((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    found = 0
    for page in PAGES:
        for arguments in re.findall(r"pip install ([^\n`#]+)", page.read_text()):
            found += 1
            for word in shlex.split(arguments):
                assert not word.startswith("ur-emulator"), f"{page.name}: {word} is on no index"
                if "[" in word and "[...]" not in word:
                    assert set(word.split("[")[1].rstrip("].,;:").split(",")) <= extras.keys(), (page.name, word)
    assert found > 5


@pytest.fixture
def network(request: pytest.FixtureRequest) -> Iterator[list[str]]:
    """The command prefix that runs something in the page's network."""
    if sys.platform != "linux" or os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "nsenter", "setpriv"))):
        pytest.skip("separate networks need administrator rights on Linux (unshare, nsenter, setpriv)")
    hosts = [robot.host for robot in robots(request.param) if not robot.host.startswith("127.")]
    command = ["unshare", "--net", sys.executable, "-c", NAMESPACE, *hosts]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stderr is not None
        try:
            if holder.stdout.readline() != "up\n":
                pytest.skip(f"no separate network: {holder.stderr.read()[-200:]}")
            yield ["nsenter", "--target", str(holder.pid), "--net", "--"]
        finally:
            holder.kill()


@pytest.fixture(scope="module")
def cloned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cloned") / "clone"
    clone(folder)
    return folder


@pytest.mark.page
@pytest.mark.timeout(3 * DEADLINE_S)
@pytest.mark.parametrize(
    ("network", "page"),
    [pytest.param(page, page, id=page.stem, marks=() if page.stem in OFTEN else pytest.mark.long) for page in RUN],
    indirect=["network"],
)
def test_the_blocks_of_a_page_run(network: list[str], page: Path, tmp_path: Path, cloned: Path) -> None:
    user = User([*network, *UNPRIVILEGED], tmp_path, move_in(tmp_path, page, cloned))
    with ExitStack() as reader:
        for robot in robots(page):
            start = f"ur-emulator --host {robot.host} --no-pendant {' '.join(robot.options)}"
            reader.enter_context(Terminal(user, start))
        for block in runs(page):
            if block.file:
                user.write(block)
            elif block.stays:
                reader.enter_context(Terminal(user, block.code))
            elif block.language in ("sh", "shell"):
                user.do(block, ["bash", "-euc", f"trap 'pwd > {user.place}' EXIT\n{block.code}"])
            elif block.language == "python":
                user.do(block, [sys.executable, "-c", block.code])


@pytest.mark.page
def test_what_a_page_does_not_install_is_not_there(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("`pip install '.[record]'` is all you need.")
    (tmp_path / "clone").mkdir()
    move_in(tmp_path, page, tmp_path / "clone")
    code = "import mcap, numpy, emulator; import pytest"
    done = subprocess.run([sys.executable, "-c", code], env=environment(tmp_path), capture_output=True, text=True)
    assert "No module named 'pytest'" in done.stderr


class User:
    """A reader of a page. prefix: of his commands. folder: where he is."""

    def __init__(self, prefix: list[str], home: Path, folder: Path) -> None:
        self.prefix = prefix
        self.home = home
        self.folder = folder
        self.environment = environment(home)
        self.place = home / ".place"  # where a block of shell commands ended, as the next one begins there

    def write(self, block: Block) -> None:
        (self.folder / block.file).write_text(block.code)

    def do(self, block: Block, command: list[str]) -> None:
        with (self.home / ".output").open("w+") as output:  # a file, so that background processes are not waited for
            done = subprocess.run(
                [*self.prefix, *command],
                cwd=self.folder,
                env=self.environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=DEADLINE_S,
                check=False,
            )
            output.seek(0)
            assert done.returncode == 0, f"{block.place}\n{block.code}\n{output.read()}"
        if self.place.exists():
            self.folder = Path(self.place.read_text().strip())


class Terminal:
    """Another terminal, in which a command runs until the end of the page. Waits until an emulator is ready."""

    def __init__(self, user: User, code: str) -> None:
        self._user = user
        self._code = code

    def __enter__(self) -> "Terminal":
        self._output = (self._user.home / f".terminal{time.monotonic_ns()}").open("w+")
        self._process = subprocess.Popen(
            [*self._user.prefix, "bash", "-euc", self._code],
            cwd=self._user.folder,
            env=self._user.environment,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        deadline = time.monotonic() + DEADLINE_S
        while not any(word in Path(self._output.name).read_text() for word in READY):
            assert self._process.poll() is None, f"{self._code}\n{Path(self._output.name).read_text()}"
            assert time.monotonic() < deadline, f"{self._code}\n{Path(self._output.name).read_text()}"
            time.sleep(0.05)
        return self

    def __exit__(self, *_: object) -> None:
        os.killpg(self._process.pid, signal.SIGINT)
        try:
            self._process.wait(10.0)
        finally:
            if self._process.poll() is None:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
            self._output.close()
