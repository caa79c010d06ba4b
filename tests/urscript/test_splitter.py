"""Cutting script-port bytes into programs, whatever the pieces they come in."""

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.budget import examples
from tests.rows import each_row
from urproto.text import to_bytes
from urscript import CompileError, ScriptSplitter, Unit


def split(data: bytes, size: int = 1 << 20) -> list[Unit]:
    splitter = ScriptSplitter()
    units = [unit for at in range(0, len(data), size) for unit in splitter.feed(data[at : at + size])]
    return units + splitter.flush()


STREAMS = [
    # as the official driver sends it: a command and a program in one write, one blank line behind
    (b"stop program\ndef f():\n\tsync()\nend\n\n", ["stop program", "def f():\n\tsync()\nend"]),
    (b"power on\r\n\r\nset robotmode run\r\n", ["power on", "set robotmode run"]),
    (b"\n\n   def f():\n end\n", ["   def f():\n end"]),
    (b"def f():\nend\ndef g():\nend\n", ["def f():\nend", "def g():\nend"]),
    (b"def f(): end def g(): end\n", ["def f(): end", " def g(): end"]),
    (b"sec s():\n set_digital_out(0, True)\nend\nmovej(q)\n", ["sec s():\n set_digital_out(0, True)\nend", "movej(q)"]),
    (b"def f():\n thread t():\n while True:\n sync()\n end\n end\n if a: b() end\nend\nf()\n", None),
    (b'def f():\n x = "end" # end\n y = "\nend\n"\nend\n', ['def f():\n x = "end" # end\n y = "\nend\n"\nend']),
    (b"# only a comment\n\n  # another\nx = 1\n", ["x = 1"]),
    (b"def f():\n ending = 1\n an_end = 2\nend # the end\n", ["def f():\n ending = 1\n an_end = 2\nend"]),
    (b"if (a): b() end\n", ["if (a): b() end"]),
    (b"movej(p[1,\n2])\n", ["movej(p[1,", "2])"]),  # a line ends at its newline whatever it holds
    (b'textmsg("open\nstop program\n', ['textmsg("open', "stop program"]),
    (b"\xff\xfe\x00junk\n\xef\xbb\xbfx = 1\n", ["\udcff\udcfe\x00junk", "x = 1"]),
    ('textmsg("größe")\n'.encode(), ['textmsg("größe")']),
]


@each_row("size", [1, 2, 7, 1000])
@each_row(("data", "texts"), STREAMS)
def test_units(data, texts, size):
    units = split(data, size)
    if texts is not None:
        assert [unit.text for unit in units] == texts
    assert all(unit.complete for unit in units)
    assert units == split(data)


def test_kinds():
    assert [unit.kind for unit in split(b"stop program\ndef f():\nend\nwhile True:\nend\nendless()\n")] == [
        "line",
        "block",
        "block",
        "line",
    ]


def test_nothing_happens_before_the_newline():
    splitter = ScriptSplitter()
    assert splitter.feed(b"def f():\n sync()\nend") == []
    assert splitter.pending
    assert splitter.feed(b"\n") == [Unit("def f():\n sync()\nend", "block")]
    assert not splitter.pending
    assert splitter.feed(b"power on") == []
    assert splitter.feed(b"\n   \n") == [Unit("power on", "line")]
    assert not splitter.pending


def test_flush_completes_what_only_misses_a_newline():
    assert split(b"def f():\nend") == [Unit("def f():\nend", "block")]
    assert split(b"power on") == [Unit("power on", "line")]
    assert split(b"# comment") == []


def test_flush_hands_out_what_is_unfinished(compiled):
    (unit,) = split(b"def f():\n sync()\n")
    assert not unit.complete
    with pytest.raises(CompileError):
        compiled(unit.text)


def test_too_long_a_unit_is_given_up():
    splitter = ScriptSplitter(max_unit_bytes=100)
    units = splitter.feed(b"x" * 200) + splitter.feed(b"y" * 500 + b"\npower on\n")
    assert [unit.kind for unit in units] == ["error", "line"]
    assert units[1].text == "power on"
    units = splitter.feed(b'def f():\n x = "' + b"z" * 200) + splitter.feed(b'"\npower off\n')
    assert [unit.kind for unit in units] == ["error", "line"]


@pytest.mark.parametrize("rest", [b"", b"zz"])
def test_after_a_line_that_is_too_long_the_next_one_counts(rest):
    """Wherever the pieces are cut that it comes in: also right before its end."""
    splitter = ScriptSplitter(100)
    units = splitter.feed(b"z" * 200)
    units += splitter.feed(rest + b"\npower on\n")
    assert [unit.kind for unit in units] == ["error", "line"]


@settings(max_examples=examples(50), deadline=None)
@given(
    st.one_of(
        st.binary(max_size=200),
        st.lists(
            st.sampled_from(
                [b"def ", b"sec", b" f():", b"\n", b"end", b" ", b'"', b"#", b"if", b"\xef\xbb\xbf", b"\xc3", b"x=1"]
            ),
            max_size=30,
        ).map(b"".join),
    ),
    st.lists(st.integers(0, 200), max_size=10),
)
def test_any_bytes_at_any_split_give_the_same_units(data, cuts):
    splitter = ScriptSplitter()
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    units = [unit for a, b in pairwise(edges) for unit in splitter.feed(data[a:b])]
    units += splitter.flush()
    assert units == split(data)
    assert not splitter.pending
    for unit in units:  # no byte is invented
        assert to_bytes(unit.text) in data + b"\n"


@settings(max_examples=examples(15), deadline=None)
@given(st.integers(1, 50))
def test_a_program_survives_any_segment_size(size):
    program = 'def prog():\n  a = "if end" # while\n  if a == "":\n    x = p[1,2,3,4,5,6]\n  end\nend'
    (unit,) = split(program.encode() + b"\n", size)
    assert unit.text == program


def test_units_of_a_stream_compile(compiled):
    for unit in split(b"x = 1\ndef f():\n sync()\nend\nsec s():\n y = 2\nend\n", 3):
        assert compiled(unit.text).source == unit.text.lstrip("\n")
