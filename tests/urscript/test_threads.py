"""Frames, threads, critical sections, budgets."""

import pytest

from tests.rows import each_row
from urscript.runtime import MAX_THREADS, WORK_PER_SECOND


def test_a_frame_ends_where_time_is_used(run):
    text = 'def f():\n  textmsg("a")\n  sync()\n  textmsg("b")\n  sleep(0.004)\n  textmsg("c")\nend'
    assert run(text, frames=1).bench.log == ["a"]
    assert run(text, frames=2).bench.log == ["a", "b"]
    assert run(text, frames=3).bench.log == ["a", "b"]
    done = run(text)
    assert (done.bench.log, done.frames) == (["a", "b", "c"], 4)


def test_threads_take_turns_in_the_order_they_started_and_the_body_comes_last(run):
    done = run(
        "def f():\n"
        '  thread a():\n    while True:\n      textmsg("a")\n      sync()\n    end\n  end\n'
        '  thread b():\n    while True:\n      textmsg("b")\n      sync()\n    end\n  end\n'
        '  run a()\n  run b()\n  while True:\n    textmsg("m")\n    sync()\n  end\nend',
        frames=2,
    )
    assert done.bench.log == ["m", "a", "b", "a", "b", "m"]  # the body begins, then comes last
    assert [thread.name for thread in done.runtime.threads] == ["f", "a", "b"]


def test_the_program_ends_with_its_body(run):
    done = run("def f():\n  thread t():\n    while True:\n      sync()\n    end\n  end\n  run t()\n  sync()\nend")
    assert done.runtime.finished
    assert not done.runtime.threads
    assert not done.runtime.halted


def test_halt_in_a_thread_ends_the_program(run):
    done = run('def f():\n  thread t():\n    halt\n  end\n  run t()\n  movej([0,0,0,0,0,0])\n  textmsg("never")\nend')
    assert done.runtime.halted
    assert done.error is None
    assert done.bench.log == ["movej [0, 0, 0, 0, 0, 0] a=1.4 v=1.05 t=0 r=0", "movej killed"]


def test_join_waits_and_returns_at_once_for_a_finished_thread(run):
    done = run(
        "def f():\n  n = 0\n  thread t():\n    while n < 3:\n      n = n + 1\n      sync()\n    end\n  end\n"
        "  h = run t()\n  join h\n  after = n\n  join h\n  join 0\n  join 77\nend"
    )
    assert done.globals == {"n": 3, "h": 1, "after": 3}
    assert done.frames == 4


def test_kill_closes_a_thread_in_the_middle_of_a_move(run):
    done = run(
        "def f():\n  thread t():\n    movej([0,0,0,0,0,0])\n  end\n  h = run t()\n  sync()\n  kill h\n"
        '  textmsg("killed")\n  kill h\n  kill 0\n  kill 99\nend'
    )
    assert done.error is None
    assert done.bench.log[1:] == ["movej killed", "killed"]


def test_kill_takes_the_children_along(run):
    done = run(
        "def f():\n"
        '  thread child():\n    while True:\n      textmsg("child")\n      sync()\n    end\n  end\n'
        "  thread parent():\n    run child()\n    while True:\n      sync()\n    end\n  end\n"
        "  h = run parent()\n  sync()\n  sync()\n  kill h\n  sync()\n  sync()\nend"
    )
    assert done.bench.log == ["child", "child", "child"]


def test_children_outlive_a_parent_that_ends(run):
    done = run(
        "def f():\n"
        '  thread child():\n    sync()\n    textmsg("child")\n  end\n'
        "  thread parent():\n    run child()\n  end\n"
        "  run parent()\n  sleep(0.01)\nend"
    )
    assert done.bench.log == ["child"]


@pytest.mark.parametrize("victim", ["own", "parent"])
def test_a_thread_may_kill_itself_or_its_parent(run, victim):
    done = run(
        "def f():\n  own = 0\n  parent = 0\n"
        f'  thread c():\n    sync()\n    kill {victim}\n    textmsg("never")\n  end\n'
        "  thread p():\n    own = run c()\n    while True:\n      sync()\n    end\n  end\n"
        '  parent = run p()\n  sleep(0.02)\n  textmsg("end")\nend'
    )
    assert done.error is None
    assert done.bench.log == ["end"]


def test_the_program_body_cannot_be_killed(run):
    done = run('def f():\n  thread t():\n    kill 0\n  end\n  run t()\n  sync()\n  textmsg("end")\nend')
    assert done.bench.log == ["end"]


def test_too_many_threads(run):
    done = run(
        "def f():\n  thread t():\n    while True:\n      sync()\n    end\n  end\n  while True:\n    run t()\n  end\nend"
    )
    assert done.error is not None
    assert f"More than {MAX_THREADS} threads" in done.error[2]


BUSY = "while True:\n  n = n + 1\nend\n"


def test_a_busy_loop_is_parked_and_others_go_on(run):
    done = run(
        f"def f():\n  n = 0\n  m = 0\n  thread busy():\n{BUSY}  end\n  run busy()\n"
        "  while m < 50:\n    m = m + 1\n    sync()\n  end\nend"
    )
    assert done.globals["m"] == 50
    assert done.frames == 51
    per_frame = done.globals["n"] / 50
    assert 100 < per_frame < WORK_PER_SECOND * 0.002


def test_what_a_thread_has_overdrawn_is_paid_back_in_the_frames_after(run):
    """One call that costs some frames' work at once: the thread rests until they are over, others do not."""
    lines = ["l = make_list(5000, 1, 5000)", "k = 0", "while k < 20:", "  l = l + 1", "  k = k + 1", "end"]
    body = "\n".join(lines)
    done = run(f"def f():\n{body}\nend", frames=2000)
    assert done.globals["k"] == 20
    assert done.frames > 3 * 20  # five units an element, 25,000 of them a time, and 8,000 a frame


def test_the_budget_counts_work_not_time(run):
    text = f"def f():\n  n = 0\n{BUSY}end"
    assert run(text, frames=20).globals == run(text, frames=20).globals


@each_row(
    "loop",
    [
        BUSY,
        "while True:\n  continue\nend",
        "while True:\nend",
        "while True:\n  if n == 0:\n    continue\n  end\n  n = n + 1\nend",
        "def g(a):\n  return a + 1\nend\nwhile True:\n  n = g(g(g(n)))\nend",
        "def g(d):\n  if d > 0:\n    g(d - 1)\n    g(d - 1)\n  end\nend\ng(150)",
        "l = make_list(5000, 1, 5000)\nwhile True:\n  l = l + l\nend",
        "l = make_list(5000, 1, 5000)\nk = l\nwhile l == k:\n  n = n + 1\nend",
        "l = make_list(5000, 1, 5000)\nwhile True:\n  l[7] = 2\nend",
        "m = [[1,2,3],[4,5,6],[7,8,9]]\nwhile True:\n  m = m * m\nend",
        "l = make_list(3000, 1, 3000)\nwhile True:\n  n = norm(l)\nend",
        's = "x"\nwhile True:\n  s = str_sub(str_cat(s, "abcdefgh"), 0, 500)\nend',
        "".join(f"def f{i}():\n  f{i + 1}()\n  f{i + 1}()\nend\n" for i in range(25)) + "def f25():\nend\nf0()",
    ],
)
def test_no_program_holds_a_frame(run, loop):
    """Without the budget the first frame would never end."""
    done = run(f"def prog():\n  n = 0\n{loop}\nend", frames=100)
    assert done.error is None
    assert not done.runtime.finished
    main = done.runtime.threads[0]
    assert main.parked_frames > 0


@each_row(
    ("bomb", "message"),
    [
        ('s = "x"\nwhile True:\n  s = s + s\nend', "maximum length"),
        ('s = "x"\nwhile True:\n  s = str_cat(s, s)\nend', "maximum length"),
        ("s = to_str(make_list(5000, 1, 5000))", "maximum length"),
        ("s = struct(a=1)\nwhile True:\n  s = struct(a=s, b=s)\nend", "more than"),
        ("l = [p[0,0,0,0,0,0]]\nwhile True:\n  l = [l, l]\nend", "more than 10000 elements"),
        ("l = make_list(1000000000, 0, 1000000000)", "make_list"),
        ("l = make_list(9000, make_list(9000, 0, 9000), 9000)", "more than 10000 elements"),
        ("l = make_list(1, 0, 9999)\nwhile True:\n  l[0] = l\nend", "more than 16 levels"),
        ("x = 2\nwhile True:\n  x = pow(x, 1000000)\nend", None),
        ("x = 2\nwhile True:\n  x = x * x\nend", None),
        ('x = to_num("9")\nwhile True:\n  x = x * 1000000.0\nend', None),
    ],
)
def test_no_program_takes_the_memory(run, bomb, message):
    done = run(f"def prog():\n{bomb}\nend", frames=50)
    if message is None:
        assert done.error is None
    else:
        assert done.error is not None
        assert message in done.error[2]


def test_every_thread_advances_when_all_are_busy(run):
    threads = "".join(
        f"global n{i} = 0\nthread t{i}():\nwhile True:\nn{i} = n{i} + 1\nend\nend\nrun t{i}()\n" for i in range(30)
    )
    done = run(f"def f():\n{threads}while True:\nsync()\nend\nend", frames=50)
    counts = list(done.globals.values())
    assert len(counts) == 30
    assert min(counts) > 0.5 * max(counts)


# critical sections


def test_a_parked_thread_keeps_others_out_of_its_critical_section(run):
    text = (
        "def f():\n  n = 0\n  inside = False\n  seen = 0\n"
        "  thread other():\n    while True:\n      if inside:\n        seen = seen + 1\n      end\n"
        "      sync()\n    end\n  end\n"
        "  run other()\n  sync()\n"
        "  CRITICAL\n  inside = True\n  while n < 20000:\n    n = n + 1\n  end\n  inside = False\n  EXIT\n"
        "  sync()\n  sync()\nend"
    )
    guarded = run(text.replace("CRITICAL", "enter_critical").replace("EXIT", "exit_critical"))
    assert guarded.globals["seen"] == 0
    assert guarded.frames > 10
    assert run(text.replace("CRITICAL", "").replace("EXIT", "")).globals["seen"] > 0


@each_row("wait", ["sync()", "sleep(0.01)", "movej([0,0,0,0,0,0])", "join h"])
def test_others_run_while_the_holder_waits(run, wait):
    done = run(
        "def f():\n  n = 0\n"
        "  thread other():\n    while n < 3:\n      n = n + 1\n      sync()\n    end\n  end\n"
        f"  h = run other()\n  enter_critical\n  {wait}\n  seen = n\n  exit_critical\nend"
    )
    assert done.globals["seen"] > 0


def test_a_killed_or_finished_thread_leaves_no_section_behind(run):
    done = run(
        f"def f():\n  n = 0\n  thread busy():\n    enter_critical\n{BUSY}  end\n"
        "  thread brief():\n    enter_critical\n  end\n"
        "  run brief()\n  h = run busy()\n  sync()\nend",
        frames=30,
    )
    assert not done.runtime.finished  # busy holds the section: the program body cannot go on
    free = run(
        "def f():\n  thread brief():\n    enter_critical\n  end\n"
        "  thread waiting():\n    enter_critical\n    sleep(1)\n  end\n"
        '  run brief()\n  h = run waiting()\n  sync()\n  kill h\n  sync()\n  textmsg("end")\nend'
    )
    assert free.bench.log == ["end"]


# what the host sees


def test_line_and_position_of_threads(run):
    done = run("def f():\n  def wait():\n    sync()\n    sleep(1)\n  end\n  x = 1\n  wait()\nend", frames=3)
    thread = done.runtime.threads[0]
    assert thread.position == (4, 5)
    assert done.runtime.line == 4


def test_line_follows_the_thread_that_owns_the_motion(run):
    done = run(
        "def f():\n  thread t():\n    movej([0,0,0,0,0,0])\n    sleep(1)\n  end\n  run t()\n  sleep(1)\nend", frames=1
    )
    assert done.runtime.line == 7
    done.runtime.motion_thread = done.runtime.threads[1]
    assert done.runtime.line == 3


def test_stop_closes_every_thread(run):
    done = run("def f():\n  thread t():\n    movej([0,0,0,0,0,0])\n  end\n  run t()\n  sleep(1)\nend", frames=1)
    done.runtime.stop()
    done.runtime.step()
    assert done.runtime.finished
    assert not done.runtime.threads
    assert done.bench.log[-1] == "movej killed"
    assert done.runtime.line == 0


def test_current_is_the_running_thread_only_while_it_runs(run):
    done = run("def f():\n  sync()\nend", frames=1)
    assert done.runtime.current is None


def test_runs_of_one_program_share_nothing(run):
    text = "def f():\n  n = [0]\n  n[0] = n[0] + 1\n  sync()\nend"
    assert run(text).globals == run(text).globals == {"n": [1]}
