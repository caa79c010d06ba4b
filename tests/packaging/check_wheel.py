"""Build the wheel and the source archive, check them, install the wheel into a clean environment and run it there.

Users often have a file called ``client.py`` or a folder called ``emulator`` next to them;
neither the console scripts nor the pytest plugin may pick those up.

The source archive contains everything a distribution needs: it is unpacked, and the wheel is built from there.
"""

import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"urproto", "urscript", "emulator", "client"}

PLUGIN_TEST = """
def test_process(ur_emulator):
    assert ur_emulator.describe()["model"] == "ur3"

def test_virtual_time(ur_robot):
    ur_robot.release_brakes()
    ur_robot.run_until("robot_mode == RUNNING")
"""


def main() -> None:
    """Exit non-zero, with the failing command's output, if the wheel is not fit for release."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        wheel, archive = build(folder)
        check_contents(wheel)
        check_archive(archive)
        environment = install(wheel, folder)
        run_beside_namesakes(environment, folder)
    sys.stdout.write("make wheel-check: the wheel installs and runs\n")


def build(folder: Path) -> tuple[Path, Path]:
    """Wheel and source archive; without --wheel the wheel is built from the archive."""
    run([sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)])
    (wheel,) = folder.glob("ur_emulator-*.whl")
    (archive,) = folder.glob("ur_emulator-*.tar.gz")
    run([sys.executable, "-m", "twine", "check", "--strict", str(wheel), str(archive)])
    # W002: empty __init__.py are the same file. W004: launch files, which ROS reads. W009: four packages, as intended.
    run([str(Path(sys.executable).parent / "check-wheel-contents"), "--ignore", "W002,W004,W009", str(wheel)])
    return wheel, archive


def check_archive(archive: Path) -> None:
    with tarfile.open(archive) as opened:
        names = {name.partition("/")[2] for name in opened.getnames()}
    needed = {
        "LICENSE",
        "README.md",
        "CHANGELOG.md",
        "Makefile",
        "docs/index.md",
        "examples/table.yaml",
        "tests/layers.py",
    }
    if missing := needed - names:
        raise SystemExit(f"{sorted(missing)} are missing in the source archive")
    if foreign := [name for name in names if name.startswith((".venv", "build/")) or name.endswith(".pyc")]:
        raise SystemExit(f"the source archive holds {foreign[:3]}")


def check_contents(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    top_level = {name.split("/")[0] for name in names if ".dist-info/" not in name}
    if top_level != PACKAGES:
        raise SystemExit(f"the wheel holds {sorted(top_level)}, it should hold exactly {sorted(PACKAGES)}")
    for package in PACKAGES:
        if f"{package}/py.typed" not in names:
            raise SystemExit(f"{package}/py.typed is missing in the wheel")
    models = [name for name in names if name.startswith("urproto/robots/data/") and name.endswith(".toml")]
    if len(models) < 12:
        raise SystemExit(f"the wheel holds {len(models)} robot models, it should hold twelve")


def install(wheel: Path, folder: Path) -> Path:
    environment = folder / "environment"
    venv.create(environment, with_pip=True)
    run([str(environment / "bin" / "python"), "-m", "pip", "install", "--quiet", str(wheel), "pytest"])
    return environment / "bin"


def run_beside_namesakes(binaries: Path, folder: Path) -> None:
    workplace = folder / "workplace"
    (workplace / "emulator").mkdir(parents=True)
    (workplace / "emulator" / "__init__.py").write_text("raise ImportError('the decoy emulator was imported')\n")
    (workplace / "client.py").write_text("raise ImportError('the decoy client was imported')\n")
    (workplace / "hello.script").write_text('def hello():\n  textmsg("hello")\nend\n')
    run([str(binaries / "ur-emulator"), "--version"], cwd=workplace)
    run([str(binaries / "ur-emulator"), "--model", "ur3", "--ephemeral-ports", "--exit-when-ready"], cwd=workplace)
    run([str(binaries / "ur-client"), "--help"], cwd=workplace)
    run([str(binaries / "ur-emulator-check"), "--install"], cwd=folder)
    run([str(binaries / "ur-emulator-check"), "--install"], cwd=workplace, status=1)
    (workplace / "test_robots.py").write_text(PLUGIN_TEST)
    # a robot in virtual time runs in the process of the tests, in which the decoy hides our package
    run([str(binaries / "python"), "-m", "pytest", "-k", "not virtual_time"], cwd=workplace)
    (elsewhere := folder / "elsewhere").mkdir()
    (elsewhere / "test_robots.py").write_text(PLUGIN_TEST)
    run([str(binaries / "python"), "-m", "pytest"], cwd=elsewhere)
    run([str(binaries / "urscript"), "check", "hello.script"], cwd=workplace)


def run(command: list[str], cwd: Path = ROOT, status: int = 0) -> None:
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=600, check=False)
    if done.returncode != status:
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}\n{done.stdout}\n{done.stderr}")


if __name__ == "__main__":
    main()
