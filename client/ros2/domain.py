"""Where ROS 2 looks for others: a DDS domain, set up as rmw_cyclonedds does it from the same variables.

Source: rcl (domain_id.c, localhost.c, discovery_options.c, init.c) and rmw_cyclonedds of 2024. What CYCLONEDDS_URI
says comes last and so has the last word, as there. Other than there, nodes of this machine are looked for by loopback
too: some of Fast DDS are nowhere else, and were not found otherwise (measured).
"""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final
from xml.sax.saxutils import quoteattr

from client.errors import Ros2Error

_HIGHEST: Final = 232  # the last one whose UDP ports exist
_PARTICIPANTS: Final = 32  # that are looked for on one machine; rmw_cyclonedds
_NAMES_INTERFACES: Final = "NetworkInterface"
_DEFAULT: Final = "SUBNET"
_RANGES: Final = {
    "SUBNET": "every node of the network",
    "LOCALHOST": "nodes of this machine",
    "OFF": "no other nodes",
    "SYSTEM_DEFAULT": "as CycloneDDS is configured",
}


@dataclass(frozen=True, slots=True)
class Domain:
    """A domain, and in words who is found there.

    configs: CycloneDDS's configuration for it; the first that fits this machine's network is to be taken.
    notes: what in the environment was not understood.
    """

    id: int
    configs: tuple[str, ...]
    reach: str
    notes: tuple[str, ...] = ()


def read_domain(environment: Mapping[str, str] = os.environ, domain_id: int | None = None) -> Domain:
    """The domain that ROS 2 would use; another one if its number is given. Raises Ros2Error."""
    number = _domain_id(environment.get("ROS_DOMAIN_ID", "")) if domain_id is None else domain_id
    if not 0 <= number <= _HIGHEST:
        raise Ros2Error(f"{number} is not a domain: they are numbered from 0 to {_HIGHEST}")
    reach, peers, notes = _reach(environment)
    last_word = environment.get("CYCLONEDDS_URI", "")
    configs = [
        ",".join(part for part in (_config(reach, peers, interfaces), last_word) if part)
        for interfaces in _interfaces(reach, last_word)
    ]
    words = _RANGES[reach] + (f" and of {', '.join(peers)}" if peers else "")
    return Domain(number, tuple(configs), words, tuple(notes))


def _domain_id(text: str) -> int:
    """As C reads numbers: 0x1f and 017 are numbers too."""
    if not text:
        return 0
    digits = f"0o{text[1:]}" if text[0] == "0" and text.isdigit() and len(text) > 1 else text
    try:
        return int(digits, 0)
    except ValueError:
        raise Ros2Error(f"ROS_DOMAIN_ID is {text!r}: make it a number from 0 to {_HIGHEST}") from None


def _reach(environment: Mapping[str, str]) -> tuple[str, list[str], list[str]]:
    """The range of discovery, other machines to look at, and notes."""
    if environment.get("ROS_LOCALHOST_ONLY", "").startswith("1"):
        return "LOCALHOST", [], []
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or _DEFAULT
    notes = []
    if reach not in _RANGES:
        notes.append(f"ROS_AUTOMATIC_DISCOVERY_RANGE is {reach!r}, not {', '.join(_RANGES)}: taken for LOCALHOST")
        reach = "LOCALHOST"
    peers = [peer for peer in environment.get("ROS_STATIC_PEERS", "").split(";") if peer]
    if peers and reach in ("OFF", "SYSTEM_DEFAULT"):
        notes.append(f"ROS_STATIC_PEERS has no effect with the discovery range {reach}")
        peers = []
    return reach, peers, notes


def _interfaces(reach: str, last_word: str) -> list[str]:
    """What to choose from."""
    if reach != "LOCALHOST" or _NAMES_INTERFACES in last_word or last_word.startswith("file:"):
        return [""]
    loopback = f'<{_NAMES_INTERFACES} address="127.0.0.1" priority="0" multicast="false"/>'
    usual = f'<{_NAMES_INTERFACES} autodetermine="true" priority="10"/>'
    # a machine without a network: what is usual is loopback already, and twice would be an error
    return [f"<Interfaces>{chosen}</Interfaces>" for chosen in (usual + loopback, loopback)]


def _config(reach: str, peers: list[str], interfaces: str) -> str:
    if reach == "SYSTEM_DEFAULT":
        return ""
    alone = "" if reach == "SUBNET" else "<AllowMulticast>false</AllowMulticast>"
    general = f"<General>{interfaces}{alone}</General>" if interfaces or alone else ""
    if reach == "OFF":  # nobody else has this tag
        discovery = f"<ParticipantIndex>none</ParticipantIndex><Tag>ros_discovery_off_{os.getpid()}</Tag>"
    else:
        discovery = (
            "<ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{_PARTICIPANTS}</MaxAutoParticipantIndex>"
        )
    addresses = ["localhost", *peers] if reach == "LOCALHOST" else peers
    if addresses:
        discovery += "<Peers>" + "".join(f"<Peer address={quoteattr(peer)}/>" for peer in addresses) + "</Peers>"
    return f"<CycloneDDS><Domain>{general}<Discovery>{discovery}</Discovery></Domain></CycloneDDS>"
