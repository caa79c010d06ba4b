"""What another process has taken so far, by Linux's /proc."""

import os
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def cpu_s(pid: int) -> float:
    """CPU time of all its threads [s]."""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / _TICKS_PER_S


def family(pid: int) -> list[int]:
    """The process and all that it has started, directly or not, and that run."""
    try:
        threads = [(thread / "children").read_text() for thread in Path(f"/proc/{pid}/task").iterdir()]
    except FileNotFoundError:  # it has ended meanwhile
        return []
    return [pid, *(member for text in threads for child in text.split() for member in family(int(child)))]


def family_cpu_s(pid: int) -> float:
    """CPU time of a process and all that it has started [s]."""
    return sum(map(cpu_s, family(pid)))


def memory_mib(pid: int) -> float:
    """Resident memory [MiB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def shared_mib(pid: int) -> float:
    """Resident memory, of which pages that several processes share are divided among them [MiB]."""
    rows = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return int(next(row for row in rows if row.startswith("Pss:")).split()[1]) / 1024
