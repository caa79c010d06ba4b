"""The file of an identified arm, for ``ur-emulator --arm``."""

from pathlib import Path

import yaml

from client.errors import FileError
from client.identification.identify import Identified
from urproto.durable import write_file


def write_arm(path: Path, found: Identified) -> None:
    """Write the arm file. Raises FileError if it cannot be written."""
    text = yaml.safe_dump(found.to_mapping(), sort_keys=False, default_flow_style=None, width=120)
    try:
        write_file(path, text)
    except OSError as error:
        raise FileError(path, error.strerror or str(error)) from error
