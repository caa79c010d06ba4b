"""The factory calibration of an arm: its Denavit-Hartenberg parameters, and the chain of frames for URDF.

Axes 2, 3 and 4 of a real arm are nearly parallel, so the common normals of its parameters may be hundreds of metres
away; d2 and d3 are then that large and cancel out. ``chain_of`` slides each of these frames along its axis, back to the
arm, with the algorithm documented by ur_calibration ("Calibration correction algorithm"). Joint angles and forward
kinematics do not change. ``dh_of`` is the inverse, which exists because the parameters of an arm follow from its axes.
With it, an emulated arm reports the parameters, and thus the hash, from which a calibration file was generated.

``calibration_hash`` is that of the vendor's client library (KinematicsInfo::toHash): 6 significant digits of every
parameter, joint by joint, hashed with libstdc++'s std::hash.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import atan2, cos, hypot, sin, tau
from typing import Any, Final, NamedTuple

from urproto.compat import Self
from urproto.errors import URError
from urproto.robots.model import DH, Joints, RobotModel
from urproto.text import quoted
from urproto.vectors import Matrix3, Vector3

LINKS: Final = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
"""Names of the six frames in files of ur_description."""

_VALUES: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_PARALLEL: Final = 1e-9  # rad; axes closer to parallel than this have no usable common normal
_NOTHING: Final = 1e-14  # m and rad; rounding errors of sines
_TOLERANCE: Final = 1e-7  # m and rad: accepts files with ten digits, rejects angles in another order
_MAX_OFFSET_M: Final = 0.03  # guess: calibrations move a frame by millimetres
_MAX_ROTATION_RAD: Final = 0.05  # rad (guess)
_MASK: Final = (1 << 64) - 1
_FACTOR: Final = 0xC6A4A7935BD1E995
_SEED: Final = 0xC70F6907  # libstdc++'s


class CalibrationError(URError, ValueError):
    """Not a calibration, or that of another arm. The message gives the reason."""


class LinkFrame(NamedTuple):
    """Pose of a joint's frame in the previous frame at joint angle 0."""

    position: Vector3  # m
    axes: Matrix3

    @property
    def rpy(self) -> Vector3:
        """Roll, pitch, yaw [rad] about fixed axes, as in URDF: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        r = self.axes
        return (atan2(r[7], r[8]), atan2(-r[6], hypot(r[0], r[3])), atan2(r[3], r[0]))


Chain = tuple[LinkFrame, ...]
"""Six frames: joint 1 in the base, joint 2 in joint 1, and so on. The last one, rotated by its joint, is the flange."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The calibration of an arm. hash: as stated in its file or, without a file, computed from its parameters."""

    dh: DH
    hash: str

    @classmethod
    def of(cls, dh: DH) -> Self:
        """The calibration with these parameters. Raises CalibrationError for parameters that no arm can have."""
        chain_of(dh)
        return cls(dh, calibration_hash(dh))

    @classmethod
    def from_mapping(cls, content: Any, where: str) -> Self:
        """Read the content of a YAML file: ``kinematics:`` as in ur_description, or ``dh_theta``, ``dh_a``, ``dh_d``,
        ``dh_alpha`` with six numbers each.

        where: the file name for errors. Raises CalibrationError.
        """
        if isinstance(content, Mapping) and "dh_theta" in content:
            return cls.of(_dh_lists(content, where))
        if not isinstance(content, Mapping) or not isinstance(content.get("kinematics"), Mapping):
            raise CalibrationError(f"{where}: not a calibration: it has neither `kinematics:` nor `dh_theta:`")
        kinematics = content["kinematics"]
        name = kinematics.get("hash")
        if not (name is None or isinstance(name, str)):
            raise CalibrationError(f"{where}: hash must be text, not {quoted(name)}")
        dh = _matching(_candidates(kinematics, where), name)
        return cls(dh, name or calibration_hash(dh))

    @property
    def is_whole(self) -> bool:
        """False when the hash does not match the parameters, because the file was modified."""
        return self.hash == calibration_hash(self.dh)

    def to_mapping(self) -> dict[str, Any]:
        """The content of ur_description's file. Angles are URDF's; see docs/calibration.md."""
        frames = {
            link: {key: value + 0.0 for key, value in zip(_VALUES, (*frame.position, *frame.rpy), strict=True)}
            for link, frame in zip(LINKS, chain_of(self.dh), strict=True)
        }
        return {"kinematics": {**frames, "hash": self.hash}}

    def check_model(self, model: RobotModel) -> None:
        """Raise CalibrationError if this cannot be the calibration of an arm of this model."""
        for link, own, nominal in zip(LINKS, chain_of(self.dh), chain_of(model.dh), strict=True):
            apart = hypot(*(a - b for a, b in zip(own.position, nominal.position, strict=True)))
            turned = max(abs(a - b) for a, b in zip(own.axes, nominal.axes, strict=True))
            if apart > _MAX_OFFSET_M or turned > _MAX_ROTATION_RAD:
                raise CalibrationError(
                    f"this is not a calibration of {model.title}: its {link} is {apart * 1e3:.0f} mm and "
                    f"{turned:.2f} rad from where that of {model.title} is"
                )


def calibration_hash(dh: DH) -> str:
    """The hash of these parameters in the vendor's driver: ``calib_`` and a number."""
    values = [value for joint in zip(dh.theta, dh.d, dh.a, dh.alpha, strict=True) for value in joint]
    return f"calib_{_murmur(''.join(f'{value:g}' for value in values).encode())}"


def chain_of(dh: DH) -> Chain:
    """The frames of joints 1 to 6, all near the arm. Raises CalibrationError if no such chain equals the parameters."""
    if dh.a[5] or dh.alpha[5]:
        raise CalibrationError(f"a6 and alpha6 must be 0, as the flange is joint 6's frame; they are {dh.a[5]:g}, ...")
    theta, d, a, between = list(dh.theta), list(dh.d), list(dh.a), [0.0] * 6
    for i in (1, 2):
        if d[i] == 0.0:
            continue
        c, s = cos(dh.alpha[i]), sin(dh.alpha[i])
        if abs(c) < 0.5:
            raise CalibrationError(f"alpha{i + 1} is {dh.alpha[i]:g} rad: axes {i + 1} and {i + 2} must be parallel")
        # where the next axis crosses the plane d = 0, in the axes after the rotation by theta
        along = -d[i] / c
        x, y = a[i], -along * s
        if x == y == 0.0:
            raise CalibrationError(f"axes {i + 1} and {i + 2} intersect: the link must have a length")
        between[i] = -atan2(-y, -x)
        theta[i] -= between[i]
        a[i], d[i] = -hypot(x, y), 0.0
        d[i + 1] -= along
    frames = [_frame(0.0, 0.0, 0.0, theta[0], d[0])]
    frames += [_frame(a[i], between[i], dh.alpha[i], theta[i + 1], d[i + 1]) for i in range(5)]
    return tuple(frames)


def dh_of(chain: Chain, signs: tuple[int, int] = (1, 1)) -> DH:
    """The parameters from which ``chain_of`` computes this chain.

    signs: of a2 and a3; 1 for negative values, as on every nominal arm, but -1 is equally valid. If no parameters
    result in this chain, it is approximated.
    """
    first, second, *rest = chain
    theta, d, a, alpha = [atan2(first.axes[3], first.axes[0])], [first.position[2]], [second.position[0]], []
    alpha.append(atan2(-second.axes[5], second.axes[8]))
    theta.append(atan2(-second.axes[1], second.axes[0]))
    d.append(0.0)
    for i, frame in enumerate(rest, 1):
        tilt, before, after = _tilt(frame.axes, signs[i - 1] if i < 3 else 0)
        ahead = _along_axis(frame)
        length = frame.position[0] - ahead * frame.axes[2]
        slide = -length * sin(before) / sin(tilt) if i < 3 and tilt else 0.0
        theta[i] += before
        d[i] += slide * cos(tilt)
        a.append(length * cos(before))
        alpha.append(tilt)
        theta.append(after)
        d.append(ahead - slide)
    # the displacement along axis 3 caused by joint 2 is subtracted from d3, which is the sum of both
    parts = ([0.0 if abs(value) < _NOTHING else value for value in part] for part in (a, d, alpha, theta))
    a, d, alpha, theta = parts
    return DH(_six((*a, 0.0)), _six(d), _six((*alpha, 0.0)), _six(theta))


def _six(values: Sequence[float]) -> Joints:
    a, b, c, d, e, f = (value + 0.0 for value in values)
    return (a, b, c, d, e, f)


def _tilt(axes: Matrix3, sign: int) -> tuple[float, float, float]:
    """alpha, and the rotations about z before and after it; without a sign, there is none before."""
    if sign == 0:
        return atan2(-axes[5], axes[8]), 0.0, atan2(-axes[1], axes[0])
    skew = hypot(axes[2], axes[5])
    if skew < _PARALLEL:
        return 0.0, 0.0, atan2(axes[3], axes[0])
    # choose the tilt whose common normal has the direction that gives the length this sign
    side = sign if axes[5] <= 0.0 else -sign
    before = atan2(side * axes[2], -side * axes[5])
    return atan2(side * skew, axes[8]), before, atan2(side * axes[6], side * axes[7])


def _along_axis(frame: LinkFrame) -> float:
    """Displacement of the frame along its own axis from the line y = z = 0 of the previous frame."""
    (_, y, z), axes = frame.position, frame.axes
    return (y * axes[5] + z * axes[8]) / (axes[5] * axes[5] + axes[8] * axes[8])


def _frame(a: float, before: float, alpha: float, theta: float, d: float) -> LinkFrame:
    """Trans_x(a) Rot_z(before) Rot_x(alpha) Rot_z(theta) Trans_z(d)."""
    axes = _turn(before, alpha, theta)
    return LinkFrame((a + axes[2] * d, axes[5] * d, axes[8] * d), axes)


def _turn(before: float, alpha: float, theta: float) -> Matrix3:
    """Rz Rx Rz."""
    sb, cb, sa, ca, st, ct = sin(before), cos(before), sin(alpha), cos(alpha), sin(theta), cos(theta)
    return (
        *(cb * ct - sb * ca * st, -cb * st - sb * ca * ct, sb * sa),
        *(sb * ct + cb * ca * st, -sb * st + cb * ca * ct, -cb * sa),
        *(sa * st, sa * ct, ca),
    )


# files


def _dh_lists(content: Mapping[str, Any], where: str) -> DH:
    def six(key: str) -> Joints:
        values = content.get(key)
        if not isinstance(values, Sequence) or len(values) != 6 or not all(map(_is_number, values)):
            raise CalibrationError(f"{where}: {key} must be six numbers, not {quoted(values)}")
        return _six(values)

    return DH(a=six("dh_a"), d=six("dh_d"), alpha=six("dh_alpha"), theta=six("dh_theta"))


def _candidates(kinematics: Mapping[str, Any], where: str) -> list[DH]:
    """Parameters that result in these frames, those with the usual signs first.

    The vendor's ur_calibration writes angles about moving axes (R = Rx Ry Rz), while URDF defines fixed axes; files of
    both kinds exist. Except for arms without deviations, only one of them is consistent with parameters.
    """
    rows = [_row(kinematics, link, where) for link in LINKS]
    found = []
    for order in (_about_fixed_axes, _about_moving_axes):
        chain = tuple(LinkFrame((x, y, z), order(*angles)) for x, y, z, *angles in rows)
        for second, third in product((1, -1), repeat=2):
            dh = dh_of(chain, (second, third))
            if _same(chain_of(dh), chain):
                found.append(dh)
    if not found:
        raise CalibrationError(f"{where}: not a calibration: no Denavit-Hartenberg parameters result in these frames")
    return found


def _matching(candidates: list[DH], name: str | None) -> DH:
    """The candidate with this hash. A full turn more gives the same angle, but another hash."""
    for dh in candidates:
        for turned in _turned(dh):
            if calibration_hash(turned) == name:
                return turned
    return candidates[0]


def _turned(dh: DH) -> Iterator[DH]:
    t1, t2, t3, t4, t5, t6 = dh.theta
    for a, b, c in product((0.0, tau, -tau), repeat=3):
        yield DH(dh.a, dh.d, dh.alpha, (t1, t2 + a, t3 + b, t4 + c, t5, t6))


def _row(kinematics: Mapping[str, Any], link: str, where: str) -> list[float]:
    values = kinematics.get(link)
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{where}: {link} is missing")
    for key in _VALUES:
        if not _is_number(values.get(key)):
            raise CalibrationError(f"{where}: {key} of {link} must be a number, not {quoted(values.get(key))}")
    return [float(values[key]) for key in _VALUES]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e6


def _same(one: Chain, other: Chain) -> bool:
    return all(
        abs(a - b) < _TOLERANCE
        for own, its in zip(one, other, strict=True)
        for a, b in zip((*own.position, *own.axes), (*its.position, *its.axes), strict=True)
    )


def _about_fixed_axes(roll: float, pitch: float, yaw: float) -> Matrix3:
    sr, cr, sp, cp, sy, cy = sin(roll), cos(roll), sin(pitch), cos(pitch), sin(yaw), cos(yaw)
    return (
        *(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        *(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        *(-sp, cp * sr, cp * cr),
    )


def _about_moving_axes(roll: float, pitch: float, yaw: float) -> Matrix3:
    a, b, c, d, e, f, g, h, i = _about_fixed_axes(-roll, -pitch, -yaw)
    return (a, d, g, b, e, h, c, f, i)


# hash


def _murmur(data: bytes) -> int:
    """MurmurHash64A, as std::hash<std::string> of libstdc++ on 64-bit machines."""
    result = (_SEED ^ (len(data) * _FACTOR)) & _MASK
    whole = len(data) // 8 * 8
    for start in range(0, whole, 8):
        word = _mixed(int.from_bytes(data[start : start + 8], "little") * _FACTOR & _MASK) * _FACTOR & _MASK
        result = (result ^ word) * _FACTOR & _MASK
    if whole < len(data):
        result = (result ^ int.from_bytes(data[whole:], "little")) * _FACTOR & _MASK
    return _mixed(_mixed(result) * _FACTOR & _MASK)


def _mixed(value: int) -> int:
    return value ^ (value >> 47)
