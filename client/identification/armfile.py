"""The file of an identified arm, for ``ur-emulator --arm``."""

from pathlib import Path

import yaml

from client.errors import FileError
from client.identification.identify import Identified


def write_arm(path: Path, found: Identified) -> None:
    """Write the arm file. Raises FileError if it cannot be written."""
    text = yaml.safe_dump(found.to_mapping(), sort_keys=False, default_flow_style=None, width=120)
    try:
        path.write_text(text, "utf-8")
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
