"""A clock that processes share, and that advances only while all of them wait.

``clock.c`` and ``calls.c`` are that clock: a library that is preloaded into each process. It is compiled when it is
first needed.
"""

import hashlib
import math
import mmap
import os
import shutil
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Final

from emulator.config import ConfigError
from emulator.realtime import SHARED_CLOCK
from urproto.compat import Self

_SOURCES: Final = [Path(__file__).with_name(name) for name in ("clock.c", "calls.c")]
_HEADER: Final = Path(__file__).with_name("lockstep.h")
_COMPILER_OPTIONS: Final = ("-O2", "-shared", "-fPIC")
_SIZE: Final = 1 << 18  # of the file, more than the library needs: it is sparse
# how its contents begin
_SPEED: Final = struct.Struct("d")
_RELEASED, _RELEASED_AT = struct.Struct("I"), 8
_JOINED, _JOINED_AT = struct.Struct("I"), 12
_NOW, _NOW_AT = struct.Struct("q"), 16
_JOIN_S: Final = 5.0  # guess: how long a program may take until its first line; afterwards it has the clock, or never
_INTERPRETER: Final = 3  # PT_INTERP
_GO: Final = b"\xff Go buildinf:"


class SharedClock:
    """The clock, from entering to leaving the context; ``environment`` gives it to a process and its children.

    speed: times real time at most. Until ``release``, the clock stops after two seconds: what is started before, such
    as an emulator, stands at a fixed moment then. Raises ConfigError where there is no such clock, with the reason.
    """

    def __init__(self, speed: float = math.inf) -> None:
        if not speed > 0.0:
            raise ConfigError(f"--speed must be a positive number, not {speed}")
        self._library = _library()
        self._speed = speed

    def __enter__(self) -> Self:
        with tempfile.NamedTemporaryFile(prefix="ur-clock-", dir=_folder_in_memory(), delete=False) as file:
            file.truncate(_SIZE)
            self._file = Path(file.name)
            self._shared = mmap.mmap(file.fileno(), _SIZE)
        _SPEED.pack_into(self._shared, 0, self._speed)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shared.close()
        self._file.unlink()

    @property
    def environment(self) -> dict[str, str]:
        """Variables for a process that is to have this clock."""
        others = os.environ.get("LD_PRELOAD", "")
        return {"LD_PRELOAD": f"{self._library} {others}".strip(), SHARED_CLOCK: str(self._file)}

    @property
    def time_s(self) -> float:
        """How far it has advanced [s]."""
        return float(_NOW.unpack_from(self._shared, _NOW_AT)[0]) / 1e9

    def release(self, process: "subprocess.Popen[bytes]", joined: int) -> None:
        """Let time pass as soon as the process has the clock, which ``joined`` processes had when it was started."""
        until_s = time.monotonic() + _JOIN_S
        while self.joined == joined and process.poll() is None and time.monotonic() < until_s:
            time.sleep(0.001)
        _RELEASED.pack_into(self._shared, _RELEASED_AT, 1)

    @property
    def joined(self) -> int:
        """How many processes have had the clock."""
        return int(_JOINED.unpack_from(self._shared, _JOINED_AT)[0])


def check_program(name: str) -> None:
    """Refuse a program that would not have the clock. Raises ConfigError with the reason."""
    path = shutil.which(name)
    if path is None:
        raise ConfigError(f"there is no program {name}: give its path, or install it")
    with Path(path).open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content[:2] == b"#!":
            words = content[2:].split(b"\n", 1)[0].decode(errors="replace").split()
            interpreter = words[1] if len(words) > 1 and words[0].endswith("/env") else words[0]
            return check_program(interpreter)
        if content[:4] != b"\x7fELF":
            return  # a script without a first line, for the shell
        if content.find(_GO) >= 0:
            raise ConfigError(f"{name} is a Go program: it asks the kernel for the time, and cannot share a clock")
        if not _has_interpreter(content):
            raise ConfigError(f"{name} is linked statically: no library can be loaded into it, so it has its own clock")
        if os.stat(path).st_mode & 0o6000:
            raise ConfigError(f"{name} changes its user: the system loads no library into it, so it has its own clock")


def _has_interpreter(content: mmap.mmap) -> bool:
    """Whether an executable is linked dynamically, according to its program headers (elf(5), 64 bits)."""
    table, size, count = (*struct.unpack_from("<Q", content, 32), *struct.unpack_from("<HH", content, 54))
    return any(
        struct.unpack_from("<I", content, table + n * size)[0] == _INTERPRETER
        for n in range(count)
        if table + n * size + 4 <= len(content)
    )


def _library() -> Path:
    """The compiled library, made now unless that has happened before. Raises ConfigError."""
    if sys.platform != "linux" or sys.maxsize < 2**32:
        raise ConfigError("a shared clock needs Linux with 64 bits: run the emulator and your program separately")
    source = b"".join(path.read_bytes() for path in (*_SOURCES, _HEADER))
    compiler = os.environ.get("CC") or "cc"
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "ur-emulator")
    library = folder / f"clock-{hashlib.sha256(source).hexdigest()[:16]}.so"
    if library.exists():
        return library
    if shutil.which(compiler) is None:
        raise ConfigError(f"a shared clock needs a C compiler ({compiler}): apt install gcc libc6-dev, or set CC")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder) as place:
        made = Path(place, library.name)
        command = [compiler, *_COMPILER_OPTIONS, "-o", str(made), *map(str, _SOURCES)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            reason = (done.stderr.strip() or "no reason given").splitlines()[-1]
            raise ConfigError(f"{compiler} cannot compile the shared clock: {reason}")
        made.replace(library)  # at once, because others may be compiling it too
    return library


def _folder_in_memory() -> str | None:
    folder = Path("/dev/shm")
    return str(folder) if folder.is_dir() else None
