"""However a script is written, its work comes in small steps and its memory has bounds."""

import gc

import pytest

from tests.rows import each_row
from urproto.versions import PolyscopeVersion
from urscript import compiler
from urscript.builtins import LibrarySet
from urscript.compiler import compile_script, compile_steps
from urscript.errors import CompileError
from urscript.files import ScriptFile
from urscript.library import LIBRARIES
from urscript.meter import METER
from urscript.tokens import tokenize
from urscript.values import cut_text, to_text

VERSION = PolyscopeVersion.parse("5.22.0")
LIBRARY_SET = LibrarySet(LIBRARIES)


def compile_text(text: str) -> compiler.CompiledProgram:
    return compile_script(text, LIBRARY_SET, VERSION)


def error_of(text: str) -> CompileError:
    with pytest.raises(CompileError) as caught:
        compile_text(text)
    return caught.value


@each_row("text", ["a=1 " * 5000, "\n" * 20000, "# note\n" * 20000, "@" * 20000, "(" * 20000])
def test_a_text_of_any_shape_is_tokenized_in_short_steps(text: str) -> None:
    steps = list(tokenize(text))
    assert len(steps) > 400
    assert max(steps) < 100


def test_a_statement_that_is_too_long_is_refused_before_it_is_read_to_its_end() -> None:
    longest = ",".join(["1"] * 10_000)
    assert compile_text(f"a = [{longest}]\n").global_names == ("a",)
    error = error_of("a = [" + ",".join([longest] * 3) + "]\n")
    assert "longer than 40000" in error.message
    assert error.column < 45_000
    error = error_of(f"textmsg([{longest}])\n")
    assert "longer than 2000 tokens: assign lists to variables first" in error.message
    assert error.column < 2_100


def test_thousands_of_unknown_names_are_one_error_the_first() -> None:
    lines = "".join(f"  missing_{n}()\n" for n in range(3000))
    error = error_of(f"def program():\n  def later():\n{lines}  end\n  mising()\n  first_of_all = absent\nend\n")
    assert (error.line, error.wire) == (3, "compile_error_name_not_found:missing_0:")


def test_a_misspelt_name_among_very_many_gets_no_suggestion() -> None:
    declared = "".join(f"value_{n} = 0\n" for n in range(2100))
    assert "did you mean" not in error_of(f"{declared}b = valu_7\n").message
    assert "did you mean 'value_7'" in error_of("value_7 = 0\nb = valu_7\n").message


@pytest.mark.long
def test_a_body_has_no_longest_length() -> None:
    statements = "    a = 1\n" * 26_000
    assert compile_text(f"def program():\n  def f():\n{statements}  end\n  f()\nend\n").global_names == ()
    assert compile_text(f"def program():\n{statements}end\n").global_names == ("a",)


def test_the_cache_forgets_programs_by_the_length_of_their_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "_cache", compiler.CompiledPrograms())
    monkeypatch.setattr(compiler, "_CACHE_CHARACTERS", 1000)
    texts = [f"a = {n} # {'x' * 400}\n" for n in range(5)]
    first, work = compile_text(texts[0]), list(compile_steps(texts[0], LIBRARY_SET, VERSION))
    assert compile_text(texts[0]) is first
    for text in texts:
        compile_text(text)
    assert compile_text(texts[-1]) is compile_text(texts[-1])
    assert compile_text(texts[0]) is not first
    assert list(compile_steps(texts[0], LIBRARY_SET, VERSION)) == work, "robot time does not depend on the cache"
    assert sum(work) > 0


def test_the_text_of_a_long_list_costs_what_it_is_worth() -> None:
    METER.left = 0
    to_text([1.5] * 5000, limit=100_000)
    long = -METER.left
    METER.left = 0
    assert cut_text([1.5] * 5000, 100) == ("[" + "1.5," * 25)[:100]
    assert long > 50_000 > 2000 > -METER.left


@each_row(
    "expression",
    ["__builtins__", "__import__", "open", "globals", "METER", "_meter", "b_textmsg", "v_a", "__name__", "self"],
)
def test_names_of_the_interpreter_are_not_names_of_the_script(expression: str) -> None:
    assert error_of(f"a = {expression}\n").wire == f"compile_error_name_not_found:{expression}:"
    assert error_of(f"{expression}()\n").wire == f"compile_error_name_not_found:{expression}:"


@pytest.mark.parametrize("body", ["", "return 1\n"], ids=["empty", "not empty"])
def test_a_program_has_a_largest_number_of_defs(body: str) -> None:
    defs = "".join(f"def f{n}():\n{body}end\n" for n in range(5001))
    error = error_of(f"def program():\n{defs}end\n")
    assert "more than 5000 defs" in error.message
    assert error.line == 2 + (3 if body else 2) * 5000


@each_row("sign", ["+", "*", " and "])
def test_a_long_chain_of_operators_is_compiled_or_refused_with_advice(sign: str) -> None:
    assert compile_text(f"a = {sign.join(['True'] * 140)}\n")
    assert (
        "operators or brackets are nested more than 150 deep: use several statements"
        in error_of(f"a = {sign.join(['1'] * 160)}\n").message
    )


@each_row("data", [b"\x1c", b"\x85\n", "\u2003".encode(), b"def f():\nend\n\x1f\n", b"# Gr\xfc\xdfe\na = 1\n"])
def test_a_file_of_odd_blanks_is_read(data: bytes) -> None:
    file = ScriptFile("odd.script", data)
    assert (file.problems(LIBRARY_SET, VERSION) == []) is data.startswith(b"#")


def test_compiling_leaves_nothing_for_the_garbage_collector() -> None:
    """A collector that finds tens of thousands of objects stops the control loop for many periods."""
    text = "def p():\n" + "".join(f"  x{i} = {i} + 1\n  l{i} = [1, x{i}, p[0, 0, 0, 0, 0, {i}]]\n" for i in range(50))
    text += "  def f(a):\n    if a > 0:\n      return f(a - 1)\n    end\n    return a\n  end\n  f(3)\nend\n"
    compile_text(text.replace("p()", "first()"))  # what is made once
    gc.collect()
    gc.disable()
    try:
        compile_text(text)
        assert gc.collect() < 50
    finally:
        gc.enable()
