"""Bodies of forms that carry files (``multipart/form-data``, RFC 7578)."""

import re
from typing import Final

_BOUNDARY: Final = re.compile(r'boundary=(?:"([^"]{1,70})"|([^\s;"]{1,70}))', re.IGNORECASE)
_NAME: Final = re.compile(r'(?:^|;)\s*name="([^"]*)"|(?:^|;)\s*name=([^\s;"]+)', re.IGNORECASE)
_LINE_END: Final = b"\r\n"


def parts(content_type: str, body: bytes) -> dict[str, bytes]:
    """The parts of a form by name; the last one if a name occurs several times. Raises ValueError."""
    match = _BOUNDARY.search(content_type)
    if match is None:
        raise ValueError("the content type names no boundary")
    delimiter = b"--" + (match[1] or match[2]).encode("latin-1")
    pieces = (_LINE_END + body).split(_LINE_END + delimiter)
    if len(pieces) < 3 or not pieces[-1].startswith(b"--"):
        raise ValueError("the form does not end with its boundary")
    found = {}
    for piece in pieces[1:-1]:
        head, separator, content = piece.lstrip(b" \t").removeprefix(_LINE_END).partition(_LINE_END * 2)
        if not separator:
            raise ValueError("the headers of a part of the form are not terminated")
        found[_name(head)] = content
    return found


def _name(head: bytes) -> str:
    for line in head.decode("latin-1").split("\r\n"):
        field, _, value = line.partition(":")
        if field.strip().lower() == "content-disposition" and (match := _NAME.search(value)):
            return match[1] or match[2] or ""
    raise ValueError("a part of the form has no name")
