"""The primary interface as construct declares it, written from the reference tables.

The declarations are independent of the code under test: names are those of the client interface manual, layouts that
differ by version are written out. Everything has its exact length: a byte too many or too few anywhere is an error.
"""

import construct as c

from urproto.versions import PolyscopeVersion

D, F, U8, I8, U16, U32, I32, U64 = (
    c.Float64b,
    c.Float32b,
    c.Int8ub,
    c.Int8sb,
    c.Int16ub,
    c.Int32ub,
    c.Int32sb,
    c.Int64ub,
)


def since(version: str, cb3: str, *fields):
    """The fields if the version has them; every 5.x does."""
    return fields if PolyscopeVersion.parse(version) >= PolyscopeVersion.parse(cb3) else ()


def six(prefix: str):
    return [f"{prefix}{axis}" / D for axis in ("x", "y", "z", "rx", "ry", "rz")]


def joints(_version):
    joint = c.Struct(
        "q_actual" / D, "q_target" / D, "qd_actual" / D, "current" / F, "voltage" / F, "t_motor" / F, "t_micro" / F,
        "mode" / U8,
    )  # fmt: skip
    return c.Struct("joints" / joint[6])


def tool(_version):
    return c.Struct(
        "range0" / U8, "range1" / U8, "in0" / D, "in1" / D, "v48" / F, "out_v" / U8, "amps" / F, "temp" / F,
        "mode" / U8,
    )  # fmt: skip


def masterboard(version):
    return c.Struct(
        "di" / I32, "do" / I32, "range0" / U8, "range1" / U8, "in0" / D, "in1" / D, "dom0" / I8, "dom1" / I8,
        "out0" / D, "out1" / D, "board_temp" / F, "v48" / F, "amps" / F, "io_amps" / F, "safety_mode" / U8,
        "reduced" / U8, "euromap" / I8, "checksum" / U32,
        *since(version, "3.2", "selector" / U8, "three_position" / U8), *since(version, "3.10", "internal" / U8),
    )  # fmt: skip


def cartesian(version):
    return c.Struct(*six(""), *since(version, "3.2", *six("tcp_")))


def kinematics(_version):
    return c.Struct("checksum" / U32[6], "theta" / D[6], "a" / D[6], "d" / D[6], "alpha" / D[6], "status" / U32)


def force_mode(_version):
    return c.Struct(*six(""), "dexterity" / D)


def additional(version):
    return c.Struct(
        "pressed" / U8, "enabled" / U8, *since(version, "3.3", "io" / U8), *since(version, "3.10", "reserved" / U8)
    )


def calibration(_version):
    return c.Struct(*six("f"))


def safety(_version):
    return c.Struct("checksum" / U32, "flag0" / U8, "flag1" / U8, "elbow" / D[3], "radius" / D)


def tool_communication(_version):
    return c.Struct("enabled" / U8, "baud" / I32, "parity" / I32, "stop" / I32, "rx" / F, "tx" / F)


def tool_mode(_version):
    return c.Struct("mode" / U8, "do0" / U8, "do1" / U8)


def mode(version):
    return c.Struct(
        "timestamp" / U64, "flags" / c.Flag[7], "robot_mode" / I8, "control_mode" / U8, "target_speed" / D,
        "scaling" / D, *since(version, "3.2", "limit" / D), *since(version, "3.5", "reserved" / U8),
    )  # fmt: skip


def configuration(_version):
    return c.Struct(
        "position" / D[12], "motion" / D[12], "defaults" / D[5], "a" / D[6], "d" / D[6], "alpha" / D[6], "theta" / D[6],
        "masterboard" / I32, "box" / I32, "type" / I32, "sub_type" / I32,
    )  # fmt: skip


PARTS = {
    0: mode, 1: joints, 2: tool, 3: masterboard, 4: cartesian, 5: kinematics, 6: configuration, 7: force_mode,
    8: additional, 9: calibration, 10: safety, 11: tool_communication, 12: tool_mode,
}  # fmt: skip
FIRST_STATE_ONLY = {5, 6}


def parts_of(version: str) -> set[int]:
    """The sub-packages of a first state of this version."""
    if version.startswith("5"):
        return set(PARTS)
    late = since(version, "3.5", 10) + since(version, "3.3", 5) + since(version, "3.2", 8)
    return {0, 1, 2, 3, 4, 6, 7, 9, *late}


TEXT = c.GreedyString("utf8")
TITLE = c.PascalString(U8, "utf8")
LONG_TEXT = c.PascalString(I32, "utf8")
REQUEST = ("request_id" / U32, "requested_type" / U32)
NO_REQUEST = 8
THREAD = c.Struct("label_id" / I32, "label" / LONG_TEXT, "thread" / LONG_TEXT)
POPUP = (*REQUEST, "warning" / c.Flag, "error" / c.Flag, "blocking" / c.Flag, "title" / TITLE, "text" / TEXT)
MESSAGES = {
    0: c.Struct("text" / TEXT),
    3: c.Struct("name" / TITLE, "major" / U8, "minor" / U8, "bugfix" / I32, "build" / I32, "date" / TEXT),
    5: c.Struct("code" / I32, "argument" / I32, "mode" / U8, "data_type" / U32, "data" / U32),
    6: c.Struct("code" / I32, "argument" / I32, "level" / I32, "data_type" / U32, "data" / U32, "text" / TEXT),
    7: c.Struct("code" / I32, "argument" / I32, "title" / TITLE, "text" / TEXT),
    10: c.Struct("line" / I32, "column" / I32, "text" / TEXT),
    12: c.Struct("undocumented" / c.Bytes(9)),  # after the version message: 24 bytes in total in every capture
    14: c.Struct("threads" / c.GreedyRange(THREAD)),
}
OLD_POPUP = c.Struct("warning" / c.Flag, "error" / c.Flag, "title" / TITLE, "text" / TEXT)
HEADER = c.Struct("timestamp" / U64, "source" / I8, "kind" / U8)


def message(kind: int, requested_type: int, version: str):
    """The body of a robot message."""
    if kind == 9:
        return c.Struct(*(POPUP if requested_type == NO_REQUEST else (*REQUEST, "text" / TEXT)))
    return OLD_POPUP if kind == 2 and not since(version, "3.3", 1) else MESSAGES[kind]


# codes of values as the document lists them: up to 3.2, then, from 3.14 and 5.9
_CODES = [
    {"none": 0, "string": 3, "list": 4, "pose": 9, "bool": 11, "num": 12, "int": 13, "float": 14},
    {"none": 0, "string": 3, "list": 5, "pose": 10, "bool": 12, "num": 13, "int": 14, "float": 15},
    {"none": 0, "string": 3, "list": 17, "pose": 12, "bool": 13, "num": 14, "int": 15, "float": 16, "matrix": 18},
]


def value(version: str):
    """A variable's value with its type before it."""
    old = version.startswith("3") and not since(version, "3.3", 1)
    new = since(version, "3.14", 1) if version.startswith("3") else at_least(version, "5.9")
    codes = _CODES[0] if old else _CODES[2] if new else _CODES[1]
    any_value = c.LazyBound(lambda: whole)
    bodies = {
        "none": c.Pass, "string": c.PascalString(U16, "utf8"), "list": c.PrefixedArray(U16, any_value),
        "pose": F[6], "bool": c.Flag, "num": F, "int": I32, "float": F,
        "matrix": c.Struct("rows" / U16, "columns" / U16, "values" / any_value[c.this.rows * c.this.columns]),
    }  # fmt: skip
    cases = {code: bodies[name] for name, code in codes.items()}
    whole = c.Struct("type" / U8, "value" / c.Switch(c.this.type, cases, default=c.Error))
    return whole


def at_least(version: str, first: str) -> bool:
    return PolyscopeVersion.parse(version) >= PolyscopeVersion.parse(first)


def variables(kind: int, version: str):
    """The body of a program state message: names, values, or one variable as text."""
    if kind == 0:
        return c.Struct("start" / U16, "names" / TEXT)
    if kind == 1:
        return c.Struct(
            "start" / U16,
            "values" / c.GreedyRange(c.FocusedSeq("value", "value" / value(version), "end" / c.Const(b"\n"))),
            c.Terminated,
        )
    return c.Struct("title" / TITLE, "text" / TEXT)


class Reader:
    """Reads whole streams of one version, strictly."""

    def __init__(self, version: str) -> None:
        self.version = version
        self._parts = {kind: declare(version) for kind, declare in PARTS.items()}
        self._variables = {kind: variables(kind, version) for kind in range(3)}

    def read(self, stream: bytes):
        """Type, kind and content of every message; the content of a state is a dictionary of its parts."""
        at = 0
        while at < len(stream):
            size, kind = I32.parse(stream[at : at + 4]), stream[at + 4]
            payload = stream[at + 5 : at + size]
            assert len(payload) == size - 5, "the stream ends within a message"
            at += size
            yield {16: self._state, 20: self._message, 25: self._program_state}[kind](payload)

    def _state(self, payload: bytes):
        parts, at = {}, 0
        while at < len(payload):
            size, kind = I32.parse(payload[at : at + 4]), payload[at + 4]
            body = payload[at + 5 : at + size]
            assert self._parts[kind].sizeof() == len(body) == size - 5, f"part {kind} has {size} bytes"
            assert kind not in parts
            parts[kind] = self._parts[kind].parse(body)
            at += size
        return 16, None, parts

    def _message(self, payload: bytes):
        header, body = HEADER.parse(payload[:10]), payload[10:]
        requested_type = int.from_bytes(body[4:8], "big") if header.kind == 9 else 0
        struct = c.Struct(
            "header" / c.Computed(header), "body" / message(header.kind, requested_type, self.version), c.Terminated
        )
        return 20, header.kind, struct.parse(body)

    def _program_state(self, payload: bytes):
        kind = payload[8]
        return 25, kind, c.Struct("body" / self._variables[kind], c.Terminated).parse(payload[9:])
