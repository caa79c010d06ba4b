"""Optional dependencies: how to install the packages of one of this project's extras, for messages."""

import json
import sys
from importlib.metadata import PackageNotFoundError, distribution
from urllib.parse import unquote, urlsplit

_DISTRIBUTION = "ur-emulator"
# the first and last minor versions of Python 3 for which an extra's packages exist, as in pyproject.toml
_PYTHONS = {"plan": (10, 13), "physics": (11, 99), "learning": (11, 99)}


def how_to_install(extra: str) -> str:
    """What to do to get an extra: the command, from where this project was installed, as no package index has it."""
    first, last = _PYTHONS.get(extra, (0, 99))
    if not first <= sys.version_info.minor <= last:
        wanted = f"3.{first} or newer" if last == 99 else f"3.{first} to 3.{last}"
        return f"use Python {wanted}: the packages of the extra {extra} do not exist for this one"
    try:
        recorded = distribution(_DISTRIBUTION).read_text("direct_url.json")
    except PackageNotFoundError:
        recorded = None
    origin = json.loads(recorded) if recorded else {}
    url = str(origin.get("url", ""))
    if "dir_info" in origin:
        editable = "--editable " if origin["dir_info"].get("editable") else ""
        return f"pip install {editable}'{unquote(urlsplit(url).path)}[{extra}]'"
    if url:
        scheme = f"{origin['vcs_info']['vcs']}+" if "vcs_info" in origin else ""
        return f"pip install '{_DISTRIBUTION}[{extra}] @ {scheme}{url}'"
    return f"in the folder of ur-emulator, pip install '.[{extra}]'"
