"""Searches for inputs that make `targets` fail, guided by coverage (Atheris): ``make fuzz TIME=600``.

``fuzz.py [--time SECONDS] [--keep] [TARGET ...]``: each target for that long, one after the other, at the lowest
priority. A failure is reported once for each place in the code, and its input is written to ``--findings``. ``--keep``
adds inputs that covered more to the corpora, reduced to few and short ones; without it the repository stays as it is.
The exit status is 1 if there was a finding.
"""

import argparse
import atexit
import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).parent
REPOSITORY = HERE.parents[1]
CORPUS = HERE / "corpus"
LONGEST_INPUT = 4096  # bytes; a corpus is read by people and replayed by every test run
MAX_KEPT = 48  # inputs of a target
LONGEST_KEPT = 1024  # bytes
_CHATTER = ("#", "INFO:", "stat::", "MERGE", "WARNING: Failed to find", "Done ", '"')
HANGING_S = 120  # one input; wall-clock time, since the machine may be under load
MEMORY_MB = 3000


def kept(name: str) -> list[bytes]:
    """The corpus of a target: one Python literal a line."""
    import ast

    path = CORPUS / f"{name}.txt"
    return [ast.literal_eval(line) for line in path.read_text().splitlines()] if path.exists() else []


def keep(name: str, inputs: Sequence[bytes]) -> None:
    """Write the corpus of a target, the shortest inputs first."""
    lines = [repr(data) for data in sorted(set(inputs), key=lambda data: (len(data), data))]
    CORPUS.mkdir(exist_ok=True)
    (CORPUS / f"{name}.txt").write_text("".join(line + "\n" for line in lines))


# one target, in a separate process


def _work(name: str, findings: Path, command: str, arguments: Sequence[str]) -> None:
    """Never returns: libFuzzer ends the process. command: started by libFuzzer to merge a corpus."""
    import atheris

    sys.path[:0] = [str(REPOSITORY)]
    with atheris.instrument_imports(include=["urproto", "urscript", "emulator", "client"]):
        target = _targets()[name]
    seen: set[object] = set()

    def one(data: bytes) -> None:
        try:
            target(data)
        except Exception as error:
            place = _place(error)
            if place not in seen:
                seen.add(place)
                path = findings / f"{name}-{hashlib.sha1(data).hexdigest()[:12]}"
                path.write_bytes(data)
                print(f"\n{name}: {path}\n{traceback.format_exc()}", file=sys.stderr, flush=True)

    atheris.Setup([command, *arguments], one)
    atheris.Fuzz()


def _place(error: BaseException) -> object:
    """The identity of a failure: its type and the innermost line of our code."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if str(REPOSITORY) in frame.filename]
    return type(error).__name__, *((frame.filename, frame.lineno) for frame in frames[-1:])


def _targets() -> dict[str, object]:
    sys.path[:0] = [str(HERE.parent / folder) for folder in ("fuzzing", "servers", "programs")]
    from targets import TARGETS

    return TARGETS  # type: ignore[return-value]


# all of them


def _fuzz(name: str, seconds: int, findings: Path, *, keep_new: bool) -> None:
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-") as folder:
        known, found, small = (Path(folder, part) for part in ("known", "found", "small"))
        for path in (known, found, small):
            path.mkdir()
        for number, data in enumerate([*kept(name), *_seeds(name)]):
            Path(known, f"seed{number}").write_bytes(data)
        options = [
            f"-timeout={HANGING_S}",
            f"-report_slow_units={HANGING_S}",
            f"-rss_limit_mb={MEMORY_MB}",
            f"-artifact_prefix={findings}/{name}-",
        ]
        options += [f"-max_len={LONGEST_INPUT}", "-print_final_stats=1", "-verbosity=1"]
        command = _command(Path(folder), name, findings)
        output = _run(command, [f"-max_total_time={seconds}", *options, str(found), str(known)])
        stats = dict(line.removeprefix("stat::").split(":") for line in output if line.startswith("stat::"))
        covered = next((line.split("cov:")[1].split()[0] for line in reversed(output) if "cov:" in line), "?")
        runs = stats.get("number_of_executed_units", "?").strip()
        if keep_new:
            _run(command, ["-merge=1", *options, f"-max_len={LONGEST_KEPT}", str(small), str(found), str(known)])
            chosen = sorted((path.read_bytes() for path in small.iterdir()), key=len)
            given = set(_seeds(name))
            keep(name, [data for data in chosen if len(data) <= LONGEST_KEPT and data not in given][:MAX_KEPT])
    print(f"{name}: {runs} inputs, {covered} places covered, {len(kept(name))} inputs kept", flush=True)


def _seeds(name: str) -> list[bytes]:
    return list(_targets()[name].seeds())  # type: ignore[attr-defined]


def _command(folder: Path, name: str, findings: Path) -> Path:
    """A program of one file, which libFuzzer starts again and again to merge a corpus."""
    path = folder / "fuzz"
    words = [sys.executable, __file__, "--work", name, "--findings", str(findings), "--command", str(path), "--"]
    path.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
    path.chmod(0o755)
    return path


def _run(command: Path, arguments: Sequence[str]) -> list[str]:
    """The output of libFuzzer; tracebacks of findings are passed on to standard error."""
    process = subprocess.Popen([command, *arguments], stderr=subprocess.PIPE, text=True, errors="replace")
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if not line.startswith(_CHATTER):
            sys.stderr.write(line)
    process.wait()
    return lines


def main() -> int:
    """Fuzz, and report the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="all of them unless given")
    parser.add_argument("--time", type=int, default=60, metavar="SECONDS", help="for each target (60)")
    parser.add_argument("--keep", action="store_true", help="add to the corpora what covered more")
    parser.add_argument("--findings", type=Path, default=None, help="where inputs that fail are written")
    parser.add_argument("--work", metavar="TARGET", help=argparse.SUPPRESS)
    parser.add_argument("--command", help=argparse.SUPPRESS)
    end = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    options = parser.parse_args(sys.argv[1:end])
    if options.work:
        _work(options.work, options.findings, options.command, sys.argv[end + 1 :])
    os.nice(19)
    findings = options.findings or Path(tempfile.mkdtemp(prefix="fuzz-findings-"))
    findings.mkdir(parents=True, exist_ok=True)
    before = set(findings.iterdir())
    names = options.targets or list(_targets())
    if unknown := set(names) - set(_targets()):
        parser.error(f"unknown: {', '.join(sorted(unknown))}; there are {', '.join(_targets())}")
    for name in names:
        _fuzz(name, options.time, findings, keep_new=options.keep)
    failures = sorted(path.name for path in set(findings.iterdir()) - before)
    print(f"{len(failures)} findings" + (f" in {findings}: {', '.join(failures)}" if failures else ""))
    if not failures and options.findings is None:
        atexit.register(shutil.rmtree, findings, ignore_errors=True)
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
