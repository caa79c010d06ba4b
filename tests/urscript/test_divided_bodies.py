"""A long body is compiled in pieces; it does what it would do in one."""

from random import Random

import pytest

from urscript import analysis, compile_statements

PROGRAM = """def program():
  global total = 0
  def count(limit, step=1):
    local sum = 0
    i = 0
    while True:
      i = i + step
      if i % 2 == 0:
        continue
      elif i == 7:
        sum = sum + 100
      elif i == 9:
        sum = sum + 10
        while sum > 0:
          sum = sum - 1
          if sum < 115:
            break
          end
        end
      elif i > limit:
        break
      elif i == 13:
        return sum
      else:
        sum = sum + i
      end
      total = total + i
    end
    return [sum, i]
  end
  def depth(n):
    a = n
    b = a + 1
    if n > 0:
      c = depth(n - 1)
      return c + b
    end
    return a
  end
  def texts():
    a = ["a", "b", "c", "d", "e", "f"]
    b = [count(3), count(5), count(30), [depth(3), depth(4)], a[2], 7]
    b[4] = str_cat(b[4], a[count(1)[0] + 1])
    return b
  end
  def many(a, b, c, d, e, f=6):
    return ((a + b) * (c + d) - (e + f)) * ((a - b) * (c - d) + (e - f)) + (a + b + c + d + e + f)
  end
  thread beside():
    local x = 0
    while x < 5:
      x = x + 1
      sync()
    end
    total = total + 1000
  end
  t = run beside()
  result = texts()
  other = many(1, 2, 3, 4, 5) + many(1, 2, 3, 4, 5, 7)
  picked = [1, 2, 3, depth(2), 5, 6][3]
  join t
  late = 0
  if total > 5:
    late = total
    return
  end
  late = -1
end
"""
FAILS = """def program():
  def f(n):
    a = 1
    b = [1, 2, 3]
    c = a + b[0]
    while n > 0:
      n = n - 1
      c = c + n
      if n == 2:
        d = b[n + 5]
      end
    end
    return c
  end
  f(4)
end
"""
UNSET = """def program():
  def f(n):
    a = 1
    b = n
    if n > 5:
      late = 1
    end
    return late
  end
  f(1)
end
"""


def divide(monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    """Pieces of this size, from the shortest body on."""
    for module in (analysis, compile_statements):
        monkeypatch.setattr(module, "WHOLE", 0)
    monkeypatch.setattr(compile_statements, "_PIECE", size)
    monkeypatch.setattr(compile_statements, "_REST", 8)
    monkeypatch.setattr(compile_statements, "_ROW", 4)


def outcome(run, text):
    done = run(text)
    return dict(done.runtime.globals), done.error


@pytest.mark.parametrize("size", [12, 30])
def test_the_values_are_the_same(run, monkeypatch, size):
    values, error = outcome(run, PROGRAM)
    assert error is None
    assert values["late"] > 1000
    divide(monkeypatch, size)
    other = f"# {size}\n"  # another text, so that it is compiled anew
    assert outcome(run, PROGRAM + other) == (values, None)


@pytest.mark.parametrize(("text", "line"), [(FAILS, 10), (UNSET, 8)])
def test_an_error_is_at_the_same_place(run, monkeypatch, text, line):
    _, whole = outcome(run, text)
    divide(monkeypatch, 12)
    _, pieces = outcome(run, text + "# another text\n")
    assert pieces == whole
    assert pieces[0] == line


def ways_out(chance: Random, count: int) -> str:
    """A loop with so many ways out of a pass, of the loop and of the function, one taken after the other."""
    ways = "".join(
        f"      x = x + {chance.randint(1, 3)}\n"
        + (f"      if x == {chance.randint(1, 9 * count)}:\n        {chance.choice(ENDINGS)}\n      end\n")
        for _ in range(count)
    )
    return (
        "def program():\n  def f(x):\n    passes = 0\n    while passes < 5:\n      passes = passes + 1\n"
        f"{ways}    end\n    return [x, passes, 0]\n  end\n  result = []\n"
        + "".join(f"  a{begin} = f({begin})\n" for begin in range(12))
        + "end\n"
    )


ENDINGS = ("break", "continue", "return [x, passes, 1]")


@pytest.mark.parametrize("size", [12, 30])
@pytest.mark.parametrize("seed", range(6))
def test_the_ways_out_of_a_long_loop_are_the_same(run, monkeypatch, seed, size):
    """So long that calls of pieces are pieces of their own, and calls of these."""
    text = ways_out(Random(seed), 150)
    values, error = outcome(run, text)
    assert error is None
    divide(monkeypatch, size)
    assert outcome(run, text + f"# {size}\n") == (values, None)
