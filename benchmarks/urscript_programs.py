"""Small programs in URScript, and the same algorithms in plain Python: two dozen of what scripts do all day."""

import math
from collections.abc import Callable

from urproto.robots.pose import pose_trans

LOOP_SCRIPT = """
  def run_it():
    local total = 0.0
    local k = 0
    local odd = 0
    while k < 100000:
      total = total + k * 0.5 - total / 3.0
      if k % 2 == 1:
        odd = odd + 1
      end
      k = k + 1
    end
    return total + odd
  end
"""


def _loop() -> float:
    total, k, odd = 0.0, 0, 0
    while k < 100000:
        total = total + k * 0.5 - total / 3.0
        if k % 2 == 1:
            odd = odd + 1
        k = k + 1
    return total + odd


STRAIGHT_SCRIPT = (
    """
  def run_it():
    local x = 0.0
    local y = 1.0
    local z = 0.5
    local k = 0
    while k < 5000:
"""
    + 4
    * """
      x = x + 0.01 * (y - x) * 10.0
      y = y + 0.01 * (x * (28.0 - z) - y)
      z = z + 0.01 * (x * y - 2.5 * z)
      if z > 40.0:
        z = z - 1.0
      end
"""
    + """
      k = k + 1
    end
    return x + y + z
  end
"""
)


def _straight() -> float:
    x, y, z, k = 0.0, 1.0, 0.5, 0
    while k < 5000:
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        x = x + 0.01 * (y - x) * 10.0
        y = y + 0.01 * (x * (28.0 - z) - y)
        z = z + 0.01 * (x * y - 2.5 * z)
        if z > 40.0:
            z = z - 1.0
        k = k + 1
    return x + y + z


CALLS_SCRIPT = """
  def square(x):
    return x * x
  end
  def run_it():
    local total = 0
    local k = 0
    while k < 50000:
      total = (total + square(k % 100)) % 9973
      k = k + 1
    end
    return total
  end
"""


def _square(x: int) -> int:
    return x * x


def _calls() -> int:
    total = k = 0
    while k < 50000:
        total = (total + _square(k % 100)) % 9973
        k = k + 1
    return total


LISTS_SCRIPT = """
  def run_it():
    local q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    local goal = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]
    local k = 0
    while k < 20000:
      q = q + (goal - q) * 0.01
      k = k + 1
    end
    return q[5]
  end
"""


def _lists() -> float:
    q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    goal = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5]
    k = 0
    while k < 20000:
        difference = [a - b for a, b in zip(goal, q, strict=True)]
        step = [a * 0.01 for a in difference]
        q = [a + b for a, b in zip(q, step, strict=True)]
        k = k + 1
    return q[5]


ELEMENTS_SCRIPT = """
  def run_it():
    local q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    local total = 0.0
    local k = 0
    while k < 100000:
      total = total + q[k % 6] * q[2]
      k = k + 1
    end
    return total
  end
"""


def _elements() -> float:
    q = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    total, k = 0.0, 0
    while k < 100000:
        total = total + q[k % 6] * q[2]
        k = k + 1
    return total


SIEVE_SCRIPT = """
  def run_it():
    local prime = make_list(600, True)
    local found = 0
    local k = 2
    while k < 600:
      if prime[k]:
        found = found + 1
        local m = k * k
        while m < 600:
          prime[m] = False
          m = m + k
        end
      end
      k = k + 1
    end
    return found
  end
"""


def _sieve() -> float:
    prime = [True] * 600
    found, k = 0, 2
    while k < 600:
        if prime[k]:
            found = found + 1
            m = k * k
            while m < 600:
                prime[m] = False
                m = m + k
        k = k + 1
    return found


SORT_SCRIPT = """
  def run_it():
    local a = make_list(100, 0)
    local i = 0
    while i < 100:
      a[i] = (i * 37) % 101
      i = i + 1
    end
    i = 0
    while i < 99:
      local j = 0
      while j < 99 - i:
        if a[j] > a[j + 1]:
          local held = a[j]
          a[j] = a[j + 1]
          a[j + 1] = held
        end
        j = j + 1
      end
      i = i + 1
    end
    return a[50] + a[99]
  end
"""


def _sort() -> float:
    a = [(i * 37) % 101 for i in range(100)]
    i = 0
    while i < 99:
        j = 0
        while j < 99 - i:
            if a[j] > a[j + 1]:
                held = a[j]
                a[j] = a[j + 1]
                a[j + 1] = held
            j = j + 1
        i = i + 1
    return a[50] + a[99]


RECURSION_SCRIPT = """
  def fib(n):
    if n < 2:
      return n
    end
    return fib(n - 1) + fib(n - 2)
  end
  def run_it():
    return fib(17)
  end
"""


def _fib(n: int) -> int:
    return n if n < 2 else _fib(n - 1) + _fib(n - 2)


KEYWORDS_SCRIPT = """
  def mix(a, share=0.5, offset=1.0):
    return a * share + offset
  end
  def run_it():
    local total = 0.0
    local k = 0
    while k < 20000:
      total = mix(total, offset=0.25)
      k = k + 1
    end
    return total
  end
"""


def _mix(a: float, share: float = 0.5, offset: float = 1.0) -> float:
    return a * share + offset


def _keywords() -> float:
    total, k = 0.0, 0
    while k < 20000:
        total = _mix(total, offset=0.25)
        k = k + 1
    return total


SUMS_SCRIPT = """
  def run_it():
    local a = make_list(200, 1.5)
    local total = 0.0
    local round = 0
    while round < 100:
      local k = 0
      while k < length(a):
        total = total + a[k]
        k = k + 1
      end
      round = round + 1
    end
    return total
  end
"""


def _sums() -> float:
    a = [1.5] * 200
    total, turn = 0.0, 0
    while turn < 100:
        k = 0
        while k < len(a):
            total = total + a[k]
            k = k + 1
        turn = turn + 1
    return total


WRITES_SCRIPT = """
  def run_it():
    local a = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    local k = 0
    while k < 50000:
      a[k % 8] = a[(k + 1) % 8] + 1.0
      k = k + 1
    end
    return a[3]
  end
"""


def _writes() -> float:
    a, k = [0.0] * 8, 0
    while k < 50000:
        a[k % 8] = a[(k + 1) % 8] + 1.0
        k = k + 1
    return a[3]


COPIES_SCRIPT = """
  def run_it():
    local a = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    local k = 0
    while k < 20000:
      local b = a
      b[k % 6] = b[k % 6] + 1.0
      a = b
      k = k + 1
    end
    return a[2]
  end
"""


def _copies() -> float:
    a, k = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], 0
    while k < 20000:
        b = a.copy()
        b[k % 6] = b[k % 6] + 1.0
        a = b.copy()
        k = k + 1
    return a[2]


GCD_SCRIPT = """
  def run_it():
    local total = 0
    local k = 1
    while k < 3000:
      local a = 360360
      local b = k
      while b > 0:
        local rest = a % b
        a = b
        b = rest
      end
      total = total + a
      k = k + 1
    end
    return total
  end
"""


def _gcd() -> float:
    total, k = 0, 1
    while k < 3000:
        a, b = 360360, k
        while b > 0:
            rest = a % b
            a = b
            b = rest
        total = total + a
        k = k + 1
    return total


LOGIC_SCRIPT = """
  def run_it():
    local hits = 0
    local k = 0
    while k < 50000:
      if k % 3 == 0 and not k % 5 == 0 or k % 7 == 1:
        hits = hits + 1
      end
      k = k + 1
    end
    return hits
  end
"""


def _logic() -> float:
    hits = k = 0
    while k < 50000:
        if (k % 3 == 0 and not k % 5 == 0) or k % 7 == 1:  # noqa: SIM201 - as in URScript
            hits = hits + 1
        k = k + 1
    return hits


BRANCHES_SCRIPT = """
  def run_it():
    local a = 0
    local k = 0
    while True:
      k = k + 1
      if k > 50000:
        break
      end
      if k % 4 == 0:
        continue
      elif k % 4 == 1:
        a = a + 1
      elif k % 4 == 2:
        a = a + 2
      else:
        a = a - 1
      end
    end
    return a
  end
"""


def _branches() -> float:
    a = k = 0
    while True:
        k = k + 1
        if k > 50000:
            break
        if k % 4 == 0:
            continue
        if k % 4 == 1:
            a = a + 1
        elif k % 4 == 2:
            a = a + 2
        else:
            a = a - 1
    return a


GLOBALS_SCRIPT = """
  global counted = 0
  def run_it():
    counted = 0
    while counted < 50000:
      counted = counted + 1
    end
    return counted
  end
"""

_counted = 0


def _globals() -> float:
    global _counted
    _counted = 0
    while _counted < 50000:
        _counted = _counted + 1
    return _counted


MATHS_SCRIPT = """
  def run_it():
    local total = 0.0
    local k = 0
    while k < 20000:
      local x = k * 0.001
      total = total + sin(x) * cos(x) + sqrt(x)
      k = k + 1
    end
    return total
  end
"""


def _maths() -> float:
    total, k = 0.0, 0
    while k < 20000:
        x = k * 0.001
        total = total + math.sin(x) * math.cos(x) + math.sqrt(x)
        k = k + 1
    return total


POSES_SCRIPT = """
  def run_it():
    local here = p[0.3, 0.1, 0.2, 0.0, 3.1, 0.1]
    local k = 0
    while k < 5000:
      here = pose_trans(here, p[0.0, 0.0, 0.001, 0.0, 0.001, 0.0])
      k = k + 1
    end
    return here[0]
  end
"""


def _poses() -> float:
    here, k = (0.3, 0.1, 0.2, 0.0, 3.1, 0.1), 0
    while k < 5000:
        here = pose_trans(here, (0.0, 0.0, 0.001, 0.0, 0.001, 0.0))
        k = k + 1
    return here[0]


JOINED_SCRIPT = """
  def run_it():
    local total = 0
    local k = 0
    while k < 10000:
      local text = str_cat("joint ", to_str(k % 100))
      total = total + str_len(text)
      k = k + 1
    end
    return total
  end
"""


def _joined() -> float:
    total = k = 0
    while k < 10000:
        text = "joint " + str(k % 100)
        total = total + len(text)
        k = k + 1
    return total


LETTERS_SCRIPT = """
  def run_it():
    local text = "movej movel movec movep servoj speedl"
    local found = 0
    local round = 0
    while round < 300:
      local k = 0
      while k < str_len(text):
        if str_at(text, k) == "o":
          found = found + 1
        end
        k = k + 1
      end
      found = found + str_find(text, "servoj")
      round = round + 1
    end
    return found
  end
"""


def _letters() -> float:
    text, found, turn = "movej movel movec movep servoj speedl", 0, 0
    while turn < 300:
        k = 0
        while k < len(text):
            if text[k] == "o":
                found = found + 1
            k = k + 1
        found = found + text.find("servoj")
        turn = turn + 1
    return found


STORES_SCRIPT = """
  def run_it():
    local a = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    local k = 0
    while k < 50000:
      local i = k % 6
      a[i] = 1.5
      a[2] = k * 0.5
      k = k + 1
    end
    return a[2] + a[5]
  end
"""


def _stores() -> float:
    a, k = [0.0] * 6, 0
    while k < 50000:
        i = k % 6
        a[i] = 1.5
        a[2] = k * 0.5
        k = k + 1
    return a[2] + a[5]


NUMBERS_SCRIPT = """
  def run_it():
    local total = 0.0
    local k = 0
    while k < 10000:
      total = total + to_num("12.5") + to_num("374")
      k = k + 1
    end
    return total
  end
"""


def _numbers() -> float:
    total, k = 0.0, 0
    while k < 10000:
        total = total + float("12.5") + int("374")
        k = k + 1
    return total


SUBSTRINGS_SCRIPT = """
  def run_it():
    local text = "x=12.5;y=374"
    local found = 0
    local k = 0
    while k < 10000:
      local at = str_find(text, ";")
      if str_sub(text, at + 1) == "y=374" and str_sub(text, 2, at - 2) == "12.5":
        found = found + 1
      end
      k = k + 1
    end
    return found
  end
"""


def _substrings() -> float:
    text, found, k = "x=12.5;y=374", 0, 0
    while k < 10000:
        at = text.find(";")
        if text[at + 1 :] == "y=374" and text[2 : 2 + (at - 2)] == "12.5":
            found = found + 1
        k = k + 1
    return found


ROUNDED_SCRIPT = """
  def run_it():
    local total = 0
    local k = 0
    while k < 20000:
      total = total + floor(k * 0.3) % 7 + ceil(k / 4)
      k = k + 1
    end
    return total
  end
"""


def _rounded() -> float:
    total = k = 0
    while k < 20000:
        total = total + math.floor(k * 0.3) % 7 + math.ceil(k / 4)
        k = k + 1
    return total


CASES: tuple[tuple[str, str, Callable[[], float]], ...] = (
    ("loop of scalar arithmetic", LOOP_SCRIPT, _loop),
    ("straight-line arithmetic", STRAIGHT_SCRIPT, _straight),
    ("remainders, nested loops", GCD_SCRIPT, _gcd),
    ("and, or, not", LOGIC_SCRIPT, _logic),
    ("elif, break, continue", BRANCHES_SCRIPT, _branches),
    ("global variable", GLOBALS_SCRIPT, _globals),
    ("sin, cos, sqrt", MATHS_SCRIPT, _maths),
    ("function calls", CALLS_SCRIPT, _calls),
    ("named arguments, defaults", KEYWORDS_SCRIPT, _keywords),
    ("recursion", RECURSION_SCRIPT, lambda: _fib(17)),
    ("elements of lists", ELEMENTS_SCRIPT, _elements),
    ("elements written", WRITES_SCRIPT, _writes),
    ("elements only written", STORES_SCRIPT, _stores),
    ("sum of a list, length()", SUMS_SCRIPT, _sums),
    ("sieve of primes", SIEVE_SCRIPT, _sieve),
    ("bubble sort", SORT_SCRIPT, _sort),
    ("copies of lists", COPIES_SCRIPT, _copies),
    ("arithmetic of 6-vectors", LISTS_SCRIPT, _lists),
    ("pose_trans", POSES_SCRIPT, _poses),
    ("strings made and joined", JOINED_SCRIPT, _joined),
    ("letters of a string", LETTERS_SCRIPT, _letters),
    ("str_find, str_sub", SUBSTRINGS_SCRIPT, _substrings),
    ("to_num", NUMBERS_SCRIPT, _numbers),
    ("floor, ceil", ROUNDED_SCRIPT, _rounded),
)
