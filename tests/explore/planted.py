"""Programs with planted faults, for tests and for the benchmark of explorations."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

TABLE = Path(__file__).with_suffix(".yaml")


@dataclass(frozen=True)
class Planted:
    """A program with a fault. entry: as in the table."""

    name: str
    entry: dict[str, Any]

    @cached_property
    def mended(self) -> str:
        """The program without the fault."""
        program: str = self.entry["program"]
        for old, new in self.entry["mended"]:
            assert old in program, f"{self.name}: no {old!r}"
            program = program.replace(old, new)
        return program

    def write(self, folder: Path, *, mended: bool = False) -> Path:
        """Write the program, its peers and the plan of its exploration, which is returned."""
        plan = {"program": "it.script", "model": "ur3", **self.entry["plan"]}
        (folder / "it.script").write_text(self.mended if mended else self.entry["program"])
        if peers := self.entry.get("peers"):
            plan["peers"] = "peers.yaml"
            (folder / "peers.yaml").write_text(yaml.safe_dump(peers))
        file = folder / "it.yaml"
        file.write_text(yaml.safe_dump(plan, sort_keys=False))
        return file


def planted() -> dict[str, Planted]:
    """All of them, by name."""
    entries = yaml.safe_load(TABLE.read_text()).items()
    return {name: Planted(name, entry) for name, entry in entries if not name.startswith("_")}
