"""What docs/thesis.md tells a student to type for ROS 2 is typed: the driver's nodes, and the program beside them."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ros2_rig import free_domain

from urproto.testing.process import EmulatorProcess

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "thesis.md").read_text()
DEADLINE_S = 120.0

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="emulators need the loopback addresses of Linux")


@pytest.mark.page
@pytest.mark.timeout(2 * DEADLINE_S)
def test_a_student_gets_along_by_ros(tmp_path: Path) -> None:
    (nodes,) = re.findall(r"^ur-client (ros2 .*)$", PAGE, re.MULTILINE)
    (program,) = re.findall(r"^```ros\npython (.*)\n```$", PAGE, re.MULTILINE)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    with EmulatorProcess(["--model", "ur3"]) as robot, free_domain() as domain:
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(ROOT)))),
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "UR_ROBOT_IP": robot.host,
        }
        start = [sys.executable, "-c", "from client.cli import main; main()", *shlex.split(nodes)]
        with subprocess.Popen(start, cwd=tmp_path, env=environment) as driver:
            try:
                done = subprocess.run(
                    [sys.executable, *shlex.split(program), "1.5"],
                    cwd=tmp_path,
                    env=environment,
                    timeout=DEADLINE_S,
                    capture_output=True,
                    text=True,
                    check=False,
                )
            finally:
                driver.send_signal(signal.SIGINT)
    assert done.returncode == 0, done.stdout + done.stderr
    assert driver.returncode == 0  # like a node, for launch
    assert "goal 4 of 4 is reached" in done.stdout
    result = re.search(r"(\d+) states .* by ([0-9.]+) rad", done.stdout)
    assert result is not None, done.stdout
    assert int(result[1]) > 50
    assert 0.0 < float(result[2]) < 1.0  # the arm's lag times its speed; a busy machine's driver lags too
