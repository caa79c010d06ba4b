"""Check an installation for settings that refer to something missing, or that cannot be read."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from urscript.polyscope.document import DocumentError, Element
from urscript.polyscope.folder import ProgramsFolder
from urscript.polyscope.installation_file import tcp_settings
from urscript.polyscope.installation_sections import SettingError
from urscript.polyscope.installation_settings import SECTIONS
from urscript.polyscope.safety_section import SafetySettingsError, read_safety_settings
from urscript.polyscope.safety_settings import TAG as SAFETY_TAG


def problems_of(root: Element, folder: Path) -> Iterator[str]:
    """One line per problem, in the order of the sections. folder: the programs folder with the programs it names."""
    rows = {}
    for name, section in SECTIONS.items():
        try:
            rows[name] = section.rows(root)
        except (DocumentError, SettingError) as error:
            rows[name] = []
            if not name.startswith("safety"):
                yield f"{section.title}: {error}"
    yield from _safety(root)
    active = tcp_settings(root).get("activePose")
    tcps = [row["name"] for row in rows["tcps"]]
    if active and active not in tcps:
        yield f"TCP: the active one is {active!r}, which does not exist: there are {', '.join(tcps) or 'none'}"
    for name in ("tcps", "payloads", "features", "modbus"):
        for key, count in Counter(row[SECTIONS[name].key] for row in rows[name]).items():
            if key and count > 1:
                yield f"{SECTIONS[name].title}: {count} are called {key!r}"
    named = Counter(row["name"] for row in rows["io"] if row["name"])
    named.update(row["name"] for row in rows["modbus"])
    yield from (f"I/O: {count} signals are called {name!r}" for name, count in named.items() if count > 1)
    for row in rows["default_program"]:
        if row["load"] and ProgramsFolder(folder).find(row["file"]) is None:
            yield f"Default program: there is no {row['file'] or 'file named'} in {folder}"
    pins = Counter(row["pins"] for row in rows["safety_io"] if row["pins"] and row["function"].endswith("Input"))
    yield from (
        f"Safety: I/O: {count} functions are assigned to the input pins {pair}"
        for pair, count in pins.items()
        if count > 1
    )


def _safety(root: Element) -> Iterator[str]:
    settings = root.child(SAFETY_TAG)
    if settings is None:
        return
    try:
        configuration = read_safety_settings(settings.text)
    except SafetySettingsError as error:
        yield f"Safety: {error}"
        return
    for mode, limits in (("normal", configuration.normal), ("reduced", configuration.reduced)):
        if any(low >= high for low, high in zip(limits.joint_min, limits.joint_max, strict=True)):
            yield f"Safety: joint limits: a minimum position is not below the maximum in {mode} mode"
