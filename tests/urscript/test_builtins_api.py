"""Declaring built-ins: what a signature gives, and what is refused."""

from collections.abc import Generator

import pytest

from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import Library, LibrarySet, Runtime, RuntimeFault, compile_script
from urscript.builtins import OMITTED
from urscript.values import Any_, Bool, BoundedList, Int, Joints, ListArg, Num, Pose, PoseArg, Str, Value

VERSION = PolyscopeVersion.parse("5.22")


def declare(function, **options):
    library = Library("test")
    library.builtin(**options)(function)
    return next(iter(library.builtins.values()))


def test_a_signature_is_a_declaration():
    def movec(
        pose_via: PoseArg, type_: Int, a: Num = 1.2, axes: ListArg = (1, 1), name: Str = "x", q: Joints | None = None
    ) -> None:
        """Doc."""

    builtin = declare(movec, aliases={"a": ("a", "acc")})
    assert builtin.signature == 'movec(pose_via, type, a=1.2, axes=[1, 1], name="x", q=None)'
    assert [parameter.names for parameter in builtin.parameters] == [
        ("pose_via",),
        ("type",),
        ("a", "acc"),
        ("axes",),
        ("name",),
        ("q",),
    ]
    assert builtin.doc == "Doc."
    assert not builtin.takes_time
    assert declare(movec, status="partial", note="half").status == "partial"


def test_a_generator_takes_time():
    def wait() -> Generator[None, None, None]:
        yield

    assert declare(wait).takes_time


def test_the_host_is_not_a_parameter():
    library = Library("test", host=True)

    @library.builtin()
    def f(host: object, a: Num) -> float:
        return a + len(str(host))

    builtin = library.builtins["f"]
    assert builtin.signature == "f(a)"
    assert builtin.bind("xyz")(1) == 4


ACCEPTED = [
    (Num, 1, 1),
    (Num, 1.5, 1.5),
    (Int, 2, 2),
    (Int, 2.0, 2),
    (Bool, True, True),
    (Str, "a", "a"),
    (PoseArg, Pose([0.0] * 6), Pose([0.0] * 6)),
    (Joints, [0] * 6, [0] * 6),
    (ListArg, [], []),
    (ListArg, BoundedList([1], 3), [1]),
    (Any_, None, None),
    (float, 1, 1),
    (int, 1, 1),
    (Pose, Pose([0.0] * 6), [0.0] * 6),
    (list[float], [1], [1]),
]
MISMATCHED = [
    (Num, True),
    (Num, "1"),
    (Num, None),
    (Int, 1.5),
    (Int, True),
    (Int, 1e300),
    (Int, float("nan")),
    (Bool, 1),
    (Str, 1),
    (PoseArg, [0.0] * 6),
    (Joints, Pose([0.0] * 6)),
    (Joints, [0] * 5),
    (Joints, [True] * 6),
    (ListArg, Pose([0.0] * 6)),
]


def one_parameter(kind):
    def f(a) -> Value:
        return a

    f.__annotations__["a"] = kind
    return declare(f).bind(None)


@each_row(("kind", "given", "arrives"), ACCEPTED)
def test_accepted(kind, given, arrives):
    found = one_parameter(kind)(given)
    assert list(found) == list(arrives) if isinstance(arrives, list) else found == arrives
    assert type(found) is type(given) or kind in (Int, int)


@each_row(("kind", "given"), MISMATCHED)
def test_mismatched(kind, given):
    with pytest.raises(RuntimeFault, match="Type error: argument 'a' of f expected type"):
        one_parameter(kind)(given)


def test_defaults_and_none():
    def f(a: Num = 5, b: Num | None = None, c: ListArg = (1, 2)) -> Value:
        return [a, b, c]

    call = declare(f).bind(None)
    assert call(OMITTED, OMITTED, OMITTED) == [5, None, (1, 2)]
    assert call(1, None, [3]) == [1, None, [3]]
    with pytest.raises(RuntimeFault, match="argument 'a'"):
        call(None, None, [3])


def test_tuples_become_values():
    def pose() -> Pose:
        return (1.0, 2.0, 3.0, 0.0, 0.0, 0.0)  # type: ignore[return-value]

    def joints() -> Joints:
        return (1.0, 2.0)  # type: ignore[return-value]

    assert type(declare(pose).bind(None)()) is Pose
    assert type(declare(joints).bind(None)()) is list


def test_what_cannot_be_declared():
    def unannotated(a) -> None: ...

    def keyword_only(*, a: Num) -> None: ...

    def odd(a: dict[str, str]) -> None: ...

    def mutable(a: ListArg = [1]) -> None: ...  # noqa: B006

    for function in (unannotated, keyword_only, odd, mutable):
        with pytest.raises(TypeError):
            declare(function)


def test_names_are_declared_once():
    first, second = Library("first"), Library("second")

    def f() -> None: ...

    first.builtin()(f)
    second.builtin()(f)
    with pytest.raises(TypeError, match="twice"):
        first.builtin()(f)
    with pytest.raises(TypeError, match="in first and in second"):
        LibrarySet([first, second])


def test_versions():
    library = Library("test")

    @library.builtin(cb3=None, e="5.10")
    def new() -> None: ...

    libraries = LibrarySet([library])
    assert "new" in libraries.available(VERSION)
    assert "new" not in libraries.available(PolyscopeVersion.parse("5.9"))
    assert "new" not in libraries.available(PolyscopeVersion.parse("3.15"))
    assert "new" in libraries.builtins


def test_refused_names_compile_and_fail_when_called():
    library = Library("test")
    library.refuse("rpc_factory", note="later")
    program = compile_script('x = rpc_factory("xmlrpc", url="http://x")', LibrarySet([library]), VERSION)

    class Host:
        period_s = 0.002

        def on_label(self, number, text, option, thread): ...

    runtime = Runtime(program, Host())
    runtime.step()
    assert runtime.error is not None
    assert runtime.error.message == "rpc_factory is not emulated: later"
    assert library.builtins["rpc_factory"].status == "refused"
