"""The image, compose files and manifests agree with the code; their own tools check that they are valid."""

import fnmatch
import json
import re
import shlex
from pathlib import Path

import pytest
import typer.main
import yaml

from emulator.cli import app
from emulator.options import ROBOT_OPTIONS, configure
from emulator.ports import PORTS
from tests.rows import each_row
from urproto.compat import load_toml
from urproto.ports import PENDANT_PORT

ROOT = Path(__file__).resolve().parents[2]
DOCKER = ROOT / "docker"
INSTRUCTIONS = [
    shlex.split(line, comments=True)
    for line in (DOCKER / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    if line.strip() and not line.startswith("#")
]
COMPOSE = {path.name: yaml.safe_load(path.read_text()) for path in sorted(DOCKER.glob("compose*.yaml"))}
EXAMPLE = yaml.safe_load((ROOT / "examples" / "compose" / "compose.yaml").read_text())
SERVICE, STATEFUL_SET = yaml.safe_load_all((DOCKER / "kubernetes.yaml").read_text())
POD = STATEFUL_SET["spec"]["template"]["spec"]
(CONTAINER,) = POD["containers"]
COMMANDS = {
    "image": lambda: json_form("CMD"),
    "kubernetes": lambda: CONTAINER["args"],
    "example": lambda: EXAMPLE["services"]["robot"]["command"],
    **{name: lambda file=file: only(file["services"])["command"] for name, file in COMPOSE.items()},
}


def only(entries: dict):
    (entry,) = entries.values()
    return entry


def arguments_of(instruction: str) -> list[list[str]]:
    return [words[1:] for words in INSTRUCTIONS if words[0] == instruction]


def json_form(instruction: str) -> list[str]:
    text = (DOCKER / "Dockerfile").read_text()
    return json.loads(re.findall(rf"^ *{instruction} (\[.*\])$", text, re.MULTILINE)[-1])


def environment() -> dict[str, str]:
    return dict(word.split("=", 1) for words in arguments_of("ENV") for word in words)


def exposed() -> set[int]:
    ranges = (word.split("-") for words in arguments_of("EXPOSE") for word in words)
    return {port for ends in ranges for port in range(int(ends[0]), int(ends[-1]) + 1)}


def test_the_image_exposes_the_ports_a_robot_has_without_accessories() -> None:
    ports = {port for name, port in PORTS.items() if name not in ("tool line", "gripper", "cameras")}
    assert exposed() == ports | {PENDANT_PORT}


def test_the_image_listens_on_all_interfaces() -> None:
    assert ROBOT_OPTIONS["host"].annotation.__metadata__[0].envvar == "UR_EMULATOR_HOST"
    assert environment()["UR_EMULATOR_HOST"] == "0.0.0.0"
    assert configure(host=environment()["UR_EMULATOR_HOST"]).host_of("control") == "127.0.0.1"


def test_the_image_does_not_run_as_root() -> None:
    assert arguments_of("USER")[-1] == ["1000:1000"]


def test_the_entry_point_is_a_console_script_of_the_project() -> None:
    scripts = load_toml((ROOT / "pyproject.toml").read_text())["project"]["scripts"]
    assert json_form("ENTRYPOINT") == ["ur-emulator"]
    assert "ur-emulator" in scripts


def test_copied_files_exist_and_are_in_the_build_context() -> None:
    let_in = [
        line[1:] for line in (DOCKER / "Dockerfile.dockerignore").read_text().splitlines() if line.startswith("!")
    ]
    sources = [word for words in arguments_of("COPY") if not words[0].startswith("--") for word in words[:-1]]
    assert sources
    for source in sources:
        assert (ROOT / source).exists()
        assert any(fnmatch.fnmatch(source, pattern) for pattern in let_in), f"{source} is kept from the build"


@each_row("where", COMMANDS)
def test_commands_parse(where) -> None:
    words = [re.sub(r"\$\{\w+:-(\w+)\}", r"\1", word) for word in COMMANDS[where]()]
    context = typer.main.get_command(app).make_context("ur-emulator", list(words))
    assert configure(**{name: context.params[name] for name in ("model", "external_control", "remote_control")})


@pytest.mark.parametrize("file", COMPOSE)
def test_services_build_the_image_and_publish_existing_ports(file) -> None:
    service = only(COMPOSE[file]["services"])
    assert (DOCKER / service["build"]["context"] / service["build"]["dockerfile"]).samefile(DOCKER / "Dockerfile")
    for mapping in service.get("ports", []):
        address, ours, theirs = mapping.rsplit(":", 2)
        assert address == "127.0.0.1"
        assert ours == theirs
        assert {int(port) for port in theirs.split("-")} <= exposed()


def test_the_ros_example_puts_robot_and_driver_into_one_network() -> None:
    file = COMPOSE["compose.ros2.yaml"]
    service, network = only(file["services"]), only(file["networks"])
    (subnet,) = network["ipam"]["config"]
    assert only(service["networks"])["ipv4_address"] == "192.168.56.101"
    driver = service["command"][service["command"].index("--external-control") + 1]
    assert driver == f"{subnet['gateway']}:50002"


def test_ports_of_the_manifests_match_the_robot() -> None:
    in_service = {entry["name"]: entry["port"] for entry in SERVICE["spec"]["ports"]}
    in_pod = {entry["name"]: entry["containerPort"] for entry in CONTAINER["ports"]}
    assert in_service == in_pod
    assert in_service.items() <= PORTS.items()
    assert CONTAINER["livenessProbe"]["tcpSocket"]["port"] in in_pod


def test_the_manifests_are_consistent() -> None:
    labels = STATEFUL_SET["spec"]["template"]["metadata"]["labels"]
    assert STATEFUL_SET["spec"]["serviceName"] == SERVICE["metadata"]["name"]
    assert STATEFUL_SET["spec"]["selector"]["matchLabels"].items() <= labels.items()
    assert SERVICE["spec"]["selector"].items() <= labels.items()
    assert POD["securityContext"]["runAsNonRoot"]
    assert (
        f"{POD['securityContext']['runAsUser']}:{POD['securityContext']['runAsGroup']}" == arguments_of("USER")[-1][0]
    )
    assert CONTAINER["securityContext"]["readOnlyRootFilesystem"]


def test_the_health_check_is_the_same_everywhere() -> None:
    (health,) = arguments_of("HEALTHCHECK")
    probes = [CONTAINER[name]["exec"]["command"] for name in ("startupProbe", "readinessProbe")]
    assert probes[0] == probes[1]
    assert [word.strip("[],") for word in health[health.index("CMD") + 1 :]] == probes[0]


def test_the_base_image_is_pinned_in_a_from_line() -> None:
    """Dependabot updates images in a FROM line and ignores those in an ARG."""
    stages = {words[2] for words in arguments_of("FROM") if "AS" in words}
    bases = [words[0] for words in arguments_of("FROM") if words[0] not in stages]
    assert len(bases) == 1
    assert re.fullmatch(r"[a-z]+:\d+\.\d+\.\d+-[a-z-]+@sha256:[0-9a-f]{64}", bases[0]), bases
