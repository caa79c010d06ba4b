"""This machine: can its kernel run a loop of 500 Hz in time?

A robot takes what comes late for what did not come: an External Control program stops after some missed periods. The
three things that matter are those the vendor's driver documents: a preemptible kernel, the right to real-time
priority, and processors that do not slow down.
"""

import platform
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from client.doctor.robot import Finding, Grade

_ENOUGH_PRIORITY = 1  # any real-time priority is above everything else
_PRIORITY = (
    "sudo groupadd -f realtime && sudo usermod -aG realtime $USER && "
    "echo '@realtime - rtprio 99' | sudo tee /etc/security/limits.d/99-realtime.conf, then log in again"
)


def examine_machine() -> Iterator[Finding]:
    """What this machine lets us see."""
    if sys.platform != "linux":
        for subject in ("kernel", "real-time priority", "processor speed"):
            yield Finding(Grade.UNKNOWN, subject, f"only Linux tells; this is {platform.system() or sys.platform}")
        return
    import resource

    yield preemption(platform.version(), Path("/"))
    yield priority(resource.getrlimit(resource.RLIMIT_RTPRIO)[0])
    yield governor(Path("/"))


def preemption(version: str, root: Path) -> Finding:
    """Of a Linux kernel that describes itself like this (``uname -v``)."""
    subject = "kernel"
    try:
        real_time = (root / "sys/kernel/realtime").read_text().strip() == "1"
    except OSError:
        real_time = False
    if real_time or "PREEMPT_RT" in version:
        return Finding(Grade.GOOD, subject, "fully preemptible (PREEMPT_RT)")
    kind = "PREEMPT_DYNAMIC" if "PREEMPT_DYNAMIC" in version else "PREEMPT" if "PREEMPT" in version else "none"
    text = f"not a real-time one (preemption: {kind}): a loaded machine may be some milliseconds late"
    mend = "sudo apt install linux-image-rt-amd64 (Debian), or sudo pro enable realtime-kernel (Ubuntu), then reboot"
    return Finding(Grade.WEAK, subject, text, mend)


def priority(limit: int) -> Finding:
    """With this limit of the real-time priority; -1 is none."""
    subject = "real-time priority"
    if limit == -1 or limit >= _ENOUGH_PRIORITY:
        return Finding(Grade.GOOD, subject, "allowed" if limit == -1 else f"allowed up to {limit}")
    return Finding(Grade.WEAK, subject, "not allowed to this user: other programs may delay a control loop", _PRIORITY)


def governor(root: Path) -> Finding:
    """What the processors' speed is governed by."""
    subject = "processor speed"
    files = sorted(root.glob("sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    try:
        found = Counter(file.read_text().strip() for file in files)
    except OSError as error:
        return Finding(Grade.UNKNOWN, subject, f"{error.strerror}")
    if not found:
        return Finding(Grade.UNKNOWN, subject, "the kernel does not govern it (a virtual machine, or fixed)")
    if set(found) == {"performance"}:
        return Finding(Grade.GOOD, subject, "always the highest")
    kinds = ", ".join(f"{count} x {kind}" for kind, count in found.items())
    return Finding(Grade.WEAK, subject, f"varies: {kinds}", "sudo cpupower frequency-set -g performance")
