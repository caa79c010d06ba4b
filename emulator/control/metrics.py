"""Figures of a running emulator in the text format of Prometheus, for ``GET /metrics`` of the control API.

Each function yields the samples of one subject. A counter only grows; after a reboot of the robot, those of its
controller begin again at 0.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from emulator.clock import ClockStatistics
from emulator.controller import Controller
from emulator.servers.port import Port
from emulator.servers.read_budget import ReadBudget

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
_QUANTILES: Final = (0.5, 0.99, 0.999, 1.0)
_STATM: Final = Path("/proc/self/statm")
_PREFIX: Final = "ur_emulator_"


class Observed(Protocol):
    """The part of an emulator that is measured. statistics: of its clock, None in virtual time."""

    @property
    def controller(self) -> Controller: ...

    @property
    def servers(self) -> Mapping[str, Port]: ...

    @property
    def statistics(self) -> ClockStatistics | None: ...

    @property
    def read_budget(self) -> ReadBudget: ...


@dataclass(frozen=True, slots=True)
class Metric:
    """A metric with its values; labels: text between braces."""

    name: str
    kind: str
    help: str
    values: Mapping[str, float]

    def lines(self) -> Iterator[str]:
        name = self.name if self.name.startswith("process_") else _PREFIX + self.name
        yield f"# HELP {name} {self.help}"
        yield f"# TYPE {name} {self.kind}"
        for labels, value in self.values.items():
            yield f"{name}{{{labels}}} {value:.12g}" if labels else f"{name} {value:.12g}"


def metrics(emulator: Observed) -> bytes:
    """All metrics of an emulator, as the body of an answer."""
    return "".join(f"{line}\n" for metric in _metrics(emulator) for line in metric.lines()).encode()


def _metrics(emulator: Observed) -> Iterator[Metric]:
    yield from _time(emulator.controller, emulator.statistics)
    yield from _budgets(emulator.controller, emulator.read_budget)
    yield from _clients(emulator.servers)
    if (memory := resident_bytes()) is not None:
        yield Metric("process_resident_memory_bytes", "gauge", "Resident memory of the process.", {"": memory})


def _time(controller: Controller, statistics: ClockStatistics | None) -> Iterator[Metric]:
    yield Metric("robot_time_seconds", "gauge", "Uptime of the controller.", {"": controller.time_s})
    busy_s = controller.execution_time_ms / 1000.0
    yield Metric("period_busy_seconds", "gauge", "Duration of the last control period's work.", {"": busy_s})
    if statistics is None:
        return
    yield Metric("periods_total", "counter", "Control periods since the start.", {"": statistics.ticks})
    text = "Control periods that began a whole period late or were dropped."
    yield Metric("periods_missed_total", "counter", text, {"": statistics.missed})
    lateness = {f'quantile="{share:g}"': statistics.lateness_s(share) for share in _QUANTILES[:-1]}
    lateness[f'quantile="{_QUANTILES[-1]:g}"'] = statistics.latest_ns / 1e9
    yield Metric("period_lateness_seconds", "gauge", "Lateness of the control periods since the start.", lateness)


def _budgets(controller: Controller, reading: ReadBudget) -> Iterator[Metric]:
    work = controller.work
    text = "Work on commands, programs and files; 400000 units are a second's."
    yield Metric("work_units_total", "counter", text, {"": work.used})
    text = "How often such work had to wait for another control period."
    yield Metric("work_deferred_total", "counter", text, {"": work.deferred})
    text = "Processor time spent on what clients send; it may be a quarter of a core."
    yield Metric("reading_seconds_total", "counter", text, {"": reading.used_s})
    text = "How often a client had to wait for this processor time."
    yield Metric("reading_deferred_total", "counter", text, {"": reading.deferred})
    queues = {'queue="commands"': controller.commands_waiting, 'queue="programs"': controller.programs.texts_waiting}
    yield Metric("queue_length", "gauge", "Commands and programs that have arrived and are not answered.", queues)


def _clients(servers: Mapping[str, Port]) -> Iterator[Metric]:
    clients = {_label("port", name): len(server.connections) for name, server in servers.items()}
    yield Metric("clients", "gauge", "Clients of each port.", clients)
    unsent = {_label("port", name): _unsent(server) for name, server in servers.items()}
    yield Metric("unsent_bytes", "gauge", "Bytes that wait for clients of each port that do not read.", unsent)
    rejected = {
        f"{_label('port', name)},{_label('reason', reason)}": count
        for name, server in servers.items()
        for reason, count in server.turned_away.counts.items()
    }
    yield Metric("clients_rejected_total", "counter", "Clients that each port has rejected, by reason.", rejected)


def _unsent(server: Port) -> int:
    return sum(connection.undelivered for connection in server.connections)


def _label(name: str, value: str) -> str:
    return f'{name}="{value}"'


def resident_bytes() -> int | None:
    """Resident memory of this process [bytes]; None where the system does not tell."""
    if sys.platform == "win32":
        return None
    try:
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, AttributeError):
        return None
