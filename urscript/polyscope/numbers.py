"""Names, strings, numbers, lists and poses: parsing those in PolyScope's files, and formatting them for scripts."""

import math
import re
from collections.abc import Sequence
from decimal import Decimal
from functools import lru_cache
from typing import Final

from urproto.robots.pose import Pose, matrix_to_rotvec, pose_inv, pose_trans
from urproto.text import number as text_number
from urproto.vectors import ZERO6
from urscript.polyscope.document import DocumentError, Element

_DIGITS = 12  # decimals, as PolyScope writes poses

_DROPPED: Final = re.compile(r"[^A-Za-z0-9_]")
_FOREIGN: Final = re.compile(r"[^\W\d_]", re.UNICODE)
_UNNAMED: Final = "unnamed"


def number(text: str, what: str = "number") -> float:
    """Parse a finite number. Raises DocumentError."""
    try:
        return text_number(text)
    except ValueError:
        raise DocumentError(f"{text!r} is not a {what}") from None


def numbers(text: str) -> list[float]:
    """Parse numbers separated by commas. Raises DocumentError."""
    return [number(part) for part in text.split(",")]


def six(text: str) -> Pose:
    """Parse six numbers separated by commas. Raises DocumentError."""
    values = numbers(text)
    if len(values) != 6:
        raise DocumentError(f"expected six numbers, not {text!r}")
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)


def number_text(value: float) -> str:
    """A number as written in a script."""
    return repr(round(value, _DIGITS) + 0.0)


def double_text(value: float) -> str:
    """A number as written by Java, and therefore in PolyScope's files: 0.0, 0.001, 1.4E-4."""
    value = float(value) + 0.0
    if value == 0.0 or 1e-3 <= abs(value) < 1e7:
        text = repr(value)
        return text if "e" not in text else format(value, "f")
    digits, _, exponent = format(Decimal(repr(value)), "e").upper().partition("E")
    whole, _, rest = digits.partition(".")
    return f"{whole}.{rest.rstrip('0') or '0'}E{int(exponent)}"


def doubles_text(values: Sequence[float]) -> str:
    """Numbers separated by commas, as written in files."""
    return ", ".join(map(double_text, values))


def list_text(values: Sequence[float]) -> str:
    """A list as written in a script, with all digits."""
    return f"[{', '.join(repr(value) for value in values)}]"


def pose_text(pose: Sequence[float]) -> str:
    """A pose as written in a script."""
    return f"p[{', '.join(number_text(value) for value in pose)}]"


def taught_pose(position: Element) -> tuple[Pose, Pose]:
    """Joints [rad] and TCP pose in the base frame of a taught position.

    Older files contain the pose. Newer ones contain the joint angles, the TCP and the dimensions of the arm it was
    taught with, from which the pose is computed (equal to PolyScope's to 1e-9 in its files).
    """
    if position.get("joints"):
        return six(position.get("joints")), six(position.get("pose"))
    arm = position.child("Kinematics")
    if arm is None:
        raise DocumentError("a taught position does not contain the dimensions of the arm it was taught with")
    return _taught(
        _value(position, "JointAngles", "angles"),
        _value(position, "TCPOffset", "pose"),
        *(_value(arm, tag, "value") for tag in ("a", "d", "alpha", "deltaTheta")),
    )


@lru_cache(maxsize=10_000)  # a large program has some thousands, and each is computed at every edit
def _taught(angles: str, offset: str, *dimensions: str) -> tuple[Pose, Pose]:
    joints = six(angles)
    return joints, pose_trans(_flange(joints, *map(six, dimensions)), six(offset))


def _flange(joints: Pose, a: Pose, d: Pose, alpha: Pose, theta: Pose) -> Pose:
    """Flange pose in the base frame for a calibrated arm, whose axes are not exactly parallel."""
    pose: Pose = ZERO6
    for i in range(6):
        pose = pose_trans(pose, _link(joints[i] + theta[i], a[i], d[i], alpha[i]))
    return pose


def _link(theta: float, a: float, d: float, alpha: float) -> Pose:
    """Rot_z(theta) Trans_z(d) Trans_x(a) Rot_x(alpha)."""
    s, c, sa, ca = math.sin(theta), math.cos(theta), math.sin(alpha), math.cos(alpha)
    return (a * c, a * s, d, *matrix_to_rotvec((c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca)))


def _value(element: Element, tag: str, attribute: str) -> str:
    child = element.child(tag)
    if child is None:
        raise DocumentError(f"<{element.tag}> lacks <{tag}>")
    return child.get(attribute)


def inverse_text(pose: Pose) -> str:
    """The inverse of a pose as written in a script."""
    return pose_text(pose_inv(pose))


def identifier(name: str) -> str:
    """Convert a name in PolyScope to a name in a script.

    Blanks become underscores, letters outside ASCII their numbers (seen: Cyrillic), and other characters that a name
    cannot contain are dropped (seen in 464 pairs of files).
    """
    text = _FOREIGN.sub(lambda letter: letter[0] if letter[0].isascii() else f"u{ord(letter[0])}", name)
    text = _DROPPED.sub("", text.replace(" ", "_"))
    if not text:
        return _UNNAMED
    return f"_{text}" if text[0].isdigit() else text


def quoted(text: str) -> str:
    """A string literal. URScript has no escapes, so double quotes inside become single quotes."""
    return '"' + text.replace('"', "'") + '"'


def truth(text: str) -> str:
    """A digital value in URScript; files contain 1 and 0, or true and false."""
    return "True" if text.strip().lower() in ("1", "true", "on", "high", "hi") else "False"


def tag_in_words(tag: str) -> str:
    """The tag of a node as its title: of a Java class, ``gui.program.direction.MoveDirectionNode``, Move direction."""
    words = "".join(f" {letter.lower()}" if letter.isupper() else letter for letter in tag.rpartition(".")[2])
    return words.removesuffix(" node").strip().capitalize()
