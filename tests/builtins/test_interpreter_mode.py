"""Programs in interpreter mode, in virtual time."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.builtins.interpreter import LIBRARY
from emulator.commands.requests import InterpreterLine
from emulator.programs.interpreter import MAX_STATEMENTS
from tests.budget import examples
from tests.rows import each_row
from urproto.interpreter import AVAILABLE, LAST_ID, Reason
from urproto.modes import RuntimeState

INVALID = "Program is in an invalid state"


class InterpreterClient:
    """A client of the interpreter port."""

    def __init__(self, rig: Any) -> None:
        self.rig = rig
        self.answers: list[str] = []

    def send(self, *lines: str) -> None:
        for line in lines:
            self.rig.controller.post(InterpreterLine(line, self.answers.append))

    def request(self, line: str, ticks: int = 1) -> str:
        """Send a line; its answer, which must arrive within this many control periods."""
        before = len(self.answers)
        self.send(line)
        self.rig.tick(ticks)
        assert len(self.answers) == before + 1, self.answers[before:]
        return self.answers[-1]

    def ack(self, line: str) -> int:
        answer = self.request(line)
        kind, number, echo = answer.split(": ", 2)
        assert (kind, echo) == ("ack", line), answer
        return int(number)

    def discard(self, line: str) -> str:
        answer = self.request(line, 3)  # resolving a known name may take a period
        kind, reason, echo = answer.split(": ", 2)
        assert (kind, echo) == ("discard", line), answer
        return reason

    def state(self, line: str) -> int:
        kind, number, echo = self.request(line).split(": ", 2)
        assert (kind, echo) == ("state", line)
        return int(number)

    @property
    def ids(self) -> tuple[int, int, int]:
        """Last interpreted, executed and cleared."""
        return (self.state("statelastinterpreted"), self.state("statelastexecuted"), self.state("statelastcleared"))

    def begin(self, body: str = "interpreter_mode()") -> None:
        self.rig.start(body)
        self.rig.until(lambda: self.rig.controller.programs.interpreter.active)


@pytest.fixture
def client(rig: Any) -> InterpreterClient:
    return InterpreterClient(rig)


@pytest.fixture
def begun(client: InterpreterClient) -> InterpreterClient:
    client.begin()
    return client


def test_versions() -> None:
    for builtin in LIBRARY.builtins.values():
        assert builtin.availability == AVAILABLE


# answers


def test_without_a_program_everything_is_discarded(client: InterpreterClient) -> None:
    for line in ("x = 1", "abort", "statelastexecuted", "clear_interpreter()", ""):
        assert client.discard(line) == INVALID


def test_a_statement_starts_in_the_period_of_its_arrival(begun: InterpreterClient) -> None:
    assert begun.ack("set_digital_out(3, True)") == 1
    assert begun.rig.controller.snapshot.actual_digital_output_bits == 8


def test_a_bare_line_is_a_program_in_interpreter_mode(client: InterpreterClient) -> None:
    client.rig.submit("interpreter_mode(clearQueueOnEnter = True, clearOnEnd = True)\n")
    client.rig.until(lambda: client.rig.controller.programs.interpreter.active)
    assert client.ack("textmsg(1)") == 1


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("x = ", Reason.SYNTAX),
        ("abort end_interpreter()", Reason.SYNTAX),
        ("def f():", Reason.SYNTAX),
        ("sec f(): x = 1 end", Reason.SYNTAX),
        ("return 3", Reason.SYNTAX),
        ("break", Reason.SYNTAX),
        ("\udcff\udc80", Reason.SYNTAX),
        ("x = unknown", Reason.COMPILE),
        ("unknown()", Reason.COMPILE),
        ("run unknown()", Reason.COMPILE),
        ("global new = 1", Reason.COMPILE),
        ("def f(): if True: global new = 1 end end", Reason.COMPILE),
        ("interpreter_mode()", Reason.COMPILE),
        ("def f(): interpreter_mode() end", Reason.COMPILE),
    ],
)
def test_lines_that_do_not_compile_are_discarded(begun: InterpreterClient, line: str, reason: Reason) -> None:
    assert begun.discard(line) == reason.value
    assert begun.ack("x = 1") == 1
    assert begun.rig.state is RuntimeState.PLAYING


def test_either_all_statements_of_a_line_run_or_none(begun: InterpreterClient) -> None:
    assert begun.discard("set_digital_out(1, True) def f(): end unknown()") == "Compile error"
    assert begun.discard("f()") == "Compile error"
    assert begun.ack('def f(): return 4 end set_digital_out(2, True) textmsg(f()) x = 3 textmsg("x=", x)') == 1
    assert begun.rig.controller.snapshot.actual_digital_output_bits == 4
    assert begun.rig.texts == ["4", "x=3"]


def test_an_empty_line_is_a_statement(begun: InterpreterClient) -> None:
    """A client that sends a file line by line waits for an answer to each."""
    assert begun.ack("") == 1
    assert begun.ack("  # nothing") == 2
    assert begun.ids == (2, 2, 0)


def test_the_manuals_example(begun: InterpreterClient) -> None:
    begun.ack('def myFun(): mystring = "Hello Interpreter" textmsg(mystring) end')
    begun.ack("myFun()")
    assert begun.rig.texts == ["Hello Interpreter"]


# scope


def test_the_scope_of_the_program_body(client: InterpreterClient) -> None:
    client.begin("global g = [1, 2]\ninterpreter_mode()\nsync()\ntextmsg(g)\nsync()")
    client.ack("g[1] = 9")
    client.ack("new = g[1] + 1")
    client.ack("textmsg(new)")
    assert client.rig.controller.programs.variables == {"g": [1, 9]}, "new names are no globals"
    client.ack("end_interpreter()")
    client.rig.until(lambda: client.rig.state is RuntimeState.STOPPED)
    assert client.rig.texts == ["10", "[1,9]"]


LOCAL_SCOPE = """
def inner(p, q=2):
  local z = 3
  unset = 0
  w = make_list(2, 0, 8)
  interpreter_mode()
  w.append(z)
  textmsg(z + p, w)
  return z
end
global g = 1
textmsg(inner(10))
sync()
"""


def test_the_scope_of_a_function(client: InterpreterClient) -> None:
    client.begin(LOCAL_SCOPE)
    client.ack("p = p + q")
    client.ack("z = z * 10 w[0] = 7 w.append(8) last = w.pop() w.append(last)")
    client.ack("local own = z textmsg(own)")
    assert client.discard("textmsg(not_there)") == "Compile error"
    client.ack("end_interpreter()")
    client.rig.until(lambda: client.rig.state is RuntimeState.STOPPED)
    assert client.rig.texts == ["30", "42[7,0,8,30]", "30"]
    assert client.rig.exceptions == []


def test_functions_see_globals_but_not_locals(client: InterpreterClient) -> None:
    client.begin("global g = 5\ndef twice(a):\n  return 2 * a\nend\ninterpreter_mode()")
    client.ack("here = 1")
    assert client.discard("def f(): return here end") == "Compile error"
    client.ack("def f(a, b=1): g = g + 1 return twice(a) + b + g end")
    client.ack("textmsg(f(10))")
    assert client.rig.texts == ["27"]


def test_a_function_can_be_redefined(client: InterpreterClient) -> None:
    client.begin("def f():\n  return 1\nend\ninterpreter_mode()\nsync()\ntextmsg(f())\nsync()")
    client.ack("sleep(0.1)")
    client.send("def f(): return 2 end", "textmsg(f())", "def f(): return 3 end", "textmsg(f())", "end_interpreter()")
    client.rig.until(lambda: client.rig.state is RuntimeState.STOPPED)
    assert client.rig.texts == ["2", "3", "1"], "each line calls the function at its compilation; the program its own"


def test_recursion_and_loops(begun: InterpreterClient) -> None:
    begun.ack("def fib(n): if n < 2: return n end return fib(n - 1) + fib(n - 2) end")
    begun.ack("i = 0 while i < 10: i = i + 1 if i == 7: break end end textmsg(fib(i))")
    begun.rig.tick(5)
    assert begun.rig.texts == ["13"]


def test_threads(begun: InterpreterClient) -> None:
    """As one public client does: a thread that ends the program on contact, started by a statement."""
    begun.ack("thread guard(): while True: if force() > 60: halt end sync() end return False end")
    begun.ack("guarding = run guard()")
    begun.ack("set_digital_out(0, True)")
    assert begun.rig.state is RuntimeState.PLAYING
    begun.rig.controller.external_wrench = (0.0, 0.0, 100.0, 0.0, 0.0, 0.0)
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED, 1.0)
    assert begun.rig.exceptions == []


def test_an_error_in_a_statement_ends_the_program_at_the_call(client: InterpreterClient) -> None:
    client.begin("sync()\ninterpreter_mode()")
    client.send("x = [1]", "textmsg(x[4])", "textmsg(2)")
    client.rig.tick(2)
    (error,) = client.rig.exceptions
    assert (error.line, error.column) == (3, 3)
    assert "interpreted statement 2: textmsg(x[4])" in "\n".join(client.rig.controller.messages.history)
    assert client.rig.texts == []
    assert client.discard("x = 1") == INVALID


def test_an_error_in_an_interpreted_thread_has_the_statements_line(begun: InterpreterClient) -> None:
    begun.send("thread t(): x = [1] y = x[3] end", "run t()")
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED)
    assert [(error.line, error.column) for error in begun.rig.exceptions] == [(1, 26)]


def test_a_variable_without_a_value(begun: InterpreterClient) -> None:
    begun.send("sleep(0.01)", "x = 1")
    begun.rig.tick()
    begun.send("skipbuffer", "textmsg(x)")
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED)
    assert [error.text for error in begun.rig.exceptions] == ["Variable 'x' is used before it has a value"]


# where interpreter_mode() may be called


@each_row(
    ("body", "problem"),
    [
        ("thread t():\n  interpreter_mode()\nend\nrun t()\nsync()\nsync()", "main thread"),
        ("clear_interpreter()", "only be called by a statement"),
        ("thread t():\n  clear_interpreter()\nend\nrun t()\ninterpreter_mode()", "only be called by a statement"),
    ],
)
def test_interpreter_mode_is_refused_in_other_contexts(rig: Any, body: str, problem: str) -> None:
    assert problem in rig.fault(body)


def test_interpreter_mode_cannot_be_nested_through_a_function(client: InterpreterClient) -> None:
    client.begin("def f():\n  interpreter_mode()\nend\nf()")
    client.send("f()")
    client.rig.until(lambda: client.rig.state is RuntimeState.STOPPED)
    assert "cannot be nested" in client.rig.exceptions[0].text


def test_secondary_programs_can_only_end_interpreter_mode(begun: InterpreterClient) -> None:
    begun.rig.submit("sec s():\n  interpreter_mode()\nend\n")
    begun.rig.tick(2)
    assert any("main thread" in text for _, text in begun.rig.keys)
    begun.rig.submit("sec s():\n  end_interpreter()\nend\n")
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED)
    assert begun.rig.exceptions == []


def test_end_interpreter_without_the_mode_does_nothing(rig: Any) -> None:
    rig.run("end_interpreter()\nsync()")


# before, after, and in between


def test_lines_received_before_interpreter_mode_are_cleared(client: InterpreterClient) -> None:
    client.rig.start("sleep(0.1)\ninterpreter_mode()\nsync()")
    client.rig.tick(10)
    client.send("textmsg(1)")
    client.rig.tick(5)
    assert client.answers == [], "nothing can be said about it yet"
    assert client.state("stateunexecuted") == 1
    client.rig.until(lambda: client.rig.controller.programs.interpreter.active)
    assert client.answers[-1] == "discard: Cleaned up before interpretation: textmsg(1)"
    assert client.ids == (0, 0, 0)


def test_lines_received_before_interpreter_mode_are_kept(client: InterpreterClient) -> None:
    client.rig.start("sleep(0.1)\ninterpreter_mode(clearQueueOnEnter=False)\nsync()")
    client.rig.tick(10)
    client.send("textmsg(1)", "textmsg(2)")
    client.rig.until(lambda: len(client.answers) == 2)
    client.rig.tick()
    assert client.rig.texts == ["1", "2"]


def test_lines_after_end_interpreter_are_kept_for_the_next_time(client: InterpreterClient) -> None:
    client.begin("interpreter_mode()\nsleep(0.1)\ninterpreter_mode(False)")
    client.send("textmsg(1)", "end_interpreter()", "textmsg(2)")
    client.rig.tick(10)
    assert client.answers == ["ack: 1: textmsg(1)", "ack: 2: end_interpreter()"]
    client.rig.until(lambda: client.rig.texts == ["1", "2"])
    assert client.ids == (3, 3, 2)


def test_another_thread_ends_interpreter_mode_after_the_running_statement(client: InterpreterClient) -> None:
    client.begin('thread t():\n  sleep(0.1)\n  end_interpreter()\nend\nrun t()\ninterpreter_mode()\ntextmsg("out")')
    client.send("sleep(0.5) textmsg(1)", "textmsg(2)")
    took = client.rig.until(lambda: client.rig.state is RuntimeState.STOPPED)
    assert took == pytest.approx(0.5, abs=0.05)
    assert client.rig.texts == ["1", "out"]


TWICE = "interpreter_mode(clearOnEnd={keep})\nsleep(0.01)\ninterpreter_mode()\nsync()"


@pytest.mark.parametrize("clear", [True, False])
def test_state_left_when_interpreter_mode_ends(client: InterpreterClient, clear: bool) -> None:
    client.begin(TWICE.format(keep=clear))
    client.ack("def f(): return 4 end x = 1")
    client.ack("end_interpreter()")
    client.rig.tick()
    assert client.state("statelastcleared") == (2 if clear else 0)
    client.rig.until(lambda: client.rig.controller.programs.interpreter.active)
    if clear:
        assert client.discard("textmsg(f())") == client.discard("textmsg(x)") == "Compile error"
    else:
        client.ack("textmsg(f(), x)")
        assert client.rig.texts == ["41"]


def test_clear(client: InterpreterClient) -> None:
    client.begin("global g = 1\nthread own():\n  while True:\n    sync()\n  end\nend\nrun own()\ninterpreter_mode()")
    client.ack("def f(): return 1 end thread t(): while True: write_output_integer_register(0, 5) sync() end end")
    client.ack("x = f() g = 2 handle = run t()")
    runtime = client.rig.controller.programs.host.runtime
    assert len(runtime.threads) == 3
    before = client.rig.controller.programs.interpreter.queue.kept
    assert len(before) == 2
    assert client.ack("clear_interpreter()") == 3
    assert client.ids == (3, 3, 3)
    assert [thread.name for thread in runtime.threads] == ["prog", "own"]
    for line in ("f()", "run t()", "textmsg(x)"):
        assert client.discard(line) == "Compile error"
    assert client.ack("textmsg(g)") == 4
    assert client.rig.texts == ["2"]


def test_lines_after_a_clear_are_answered_after_it(begun: InterpreterClient) -> None:
    begun.send("def f(): return 1 end", "sleep(0.1)", "clear_interpreter()", "f()", "textmsg(2)")
    begun.rig.tick(3)
    assert [answer.split(":")[0] for answer in begun.answers] == ["ack"] * 3
    assert begun.state("stateunexecuted") == 3
    begun.rig.until(lambda: len(begun.answers) == 6)
    assert begun.answers[-2:] == ["discard: Compile error: f()", "ack: 4: textmsg(2)"]


def test_the_number_of_interpreted_statements_is_limited(begun: InterpreterClient) -> None:
    for _ in range(MAX_STATEMENTS // 50):
        begun.send(*["x = 1"] * 50)
        begun.rig.tick(10)
    assert begun.answers[-1] == f"ack: {MAX_STATEMENTS}: x = 1"
    assert begun.discard("x = 1") == "Too many interpreted messages"
    assert begun.ack("clear_interpreter()") == MAX_STATEMENTS + 1
    assert begun.ack("x = 1") == MAX_STATEMENTS + 2


def test_ids_wrap(begun: InterpreterClient) -> None:
    begun.rig.controller.programs.interpreter.queue.last_interpreted = LAST_ID - 1
    assert [begun.ack("x = 1"), begun.ack("x = 1")] == [LAST_ID, 1]


# movements


def far(joint: float, more: str = "") -> str:
    return f"movej([{joint}, -1.5, 1.5, -1.6, -1.57, 0]{more})"


def test_moves_are_executed_one_after_the_other(begun: InterpreterClient) -> None:
    begun.send(far(0.2), far(0.4), "textmsg(get_target_joint_positions()[0])")
    begun.rig.tick()
    assert begun.answers == ["ack: 1: " + far(0.2), "ack: 2: " + far(0.4), begun.answers[2]]
    begun.rig.until(lambda: begun.rig.texts == ["0.4"])
    assert begun.ids == (3, 3, 0)


def test_abort_stops_a_move_and_the_next_statement_runs(begun: InterpreterClient) -> None:
    begun.send(far(1.5), 'textmsg("stands")')
    begun.rig.seconds(0.8)
    assert begun.request("abort") == "ack: 0: abort"
    begun.rig.until(lambda: begun.rig.texts == ["stands"], 1.0)
    assert 0.05 < begun.rig.q[0] < 1.0
    assert begun.rig.controller.motion.idle


def test_abort_stops_moves_of_the_program_and_of_threads(client: InterpreterClient) -> None:
    client.rig.start(far(1.5) + "\n" + 'textmsg("next")\nsleep(5)')
    client.rig.seconds(0.8)
    assert client.request("ABORT") == "ack: 0: ABORT"
    client.rig.until(lambda: client.rig.texts == ["next"], 1.0)


@pytest.mark.parametrize("command", ["speedj([0.2,0,0,0,0,0], 1, 2)", "sleep(2)", "stopj(0.1)"])
def test_abort_stops_nothing_but_moves(begun: InterpreterClient, command: str) -> None:
    begun.send(command, "textmsg(1)")
    begun.rig.seconds(0.5)
    target = begun.rig.controller.snapshot.target_qd[0]
    begun.request("abort")
    begun.rig.tick(2)
    assert begun.rig.controller.snapshot.target_qd[0] == pytest.approx(target, abs=0.01)
    assert (begun.rig.texts == []) is not command.startswith("stopj")


def test_skipbuffer_and_abort_together(begun: InterpreterClient) -> None:
    begun.send(far(0.5), far(1.0), far(1.5), "textmsg(1)")
    begun.rig.seconds(0.4)
    assert begun.state("stateunexecuted") == 3
    assert begun.request("skipbuffer") == "ack: 0: skipbuffer"
    assert begun.state("stateunexecuted") == 0
    begun.request("abort")
    begun.rig.until(lambda: begun.rig.controller.motion.idle, 1.0)
    assert begun.rig.q[0] < 0.5
    assert begun.rig.texts == []
    assert begun.ack("textmsg(2)") == 5
    assert begun.rig.texts == ["2"]


# effects on the program


def test_interpreter_mode_while_paused(begun: InterpreterClient) -> None:
    programs = begun.rig.controller.programs
    programs.pause()
    begun.rig.until(lambda: begun.rig.state is RuntimeState.PAUSED)
    assert begun.ack("textmsg(1)") == 1
    begun.rig.seconds(0.5)
    assert begun.rig.texts == []
    programs.resume()
    begun.rig.seconds(0.2)  # RESUMING comes first
    assert begun.rig.texts == ["1"]


def test_stopping_the_program_discards_pending_statements(begun: InterpreterClient) -> None:
    begun.send("sleep(1)", "clear_interpreter()", "x = 1")
    begun.rig.tick()
    assert len(begun.answers) == 2
    begun.rig.controller.programs.stop()
    assert begun.answers[2:] == [f"discard: {INVALID}: x = 1"]
    assert begun.discard("stateunexecuted") == INVALID


def test_interpreter_mode_ends_when_the_program_is_replaced(begun: InterpreterClient) -> None:
    begun.ack("def f(): return 1 end x = 2")
    begun.begin("interpreter_mode() ")
    begun.rig.until(lambda: begun.discard("f()") == "Compile error")
    assert begun.discard("textmsg(x)") == "Compile error"
    assert begun.ack("textmsg(3)") == 1, "ids begin anew"


def test_halt_in_interpreter_mode(begun: InterpreterClient) -> None:
    begun.send("halt", "textmsg(1)")
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED)
    assert begun.rig.texts == []
    assert begun.rig.exceptions == []


def test_an_endless_computation_does_not_block_the_controller(begun: InterpreterClient) -> None:
    begun.send("while True: x = 1 end", "textmsg(1)")
    begun.rig.seconds(0.1)
    assert begun.state("statelastexecuted") == 1
    begun.rig.controller.programs.stop()
    begun.rig.until(lambda: begun.rig.state is RuntimeState.STOPPED)


def test_a_failing_listener_is_ignored(begun: InterpreterClient) -> None:
    def broken(answer: str) -> None:
        raise ConnectionError(answer)

    begun.rig.controller.post(InterpreterLine("textmsg(1)", broken))
    begun.rig.tick()
    assert begun.rig.texts == ["1"]


def test_long_lines_are_compiled_in_pieces(begun: InterpreterClient) -> None:
    """Other work of the period continues, so the answer arrives some periods later."""
    line = "x = 0 " + "x = x + [1, 2, 3][1] * 2 - 1 " * 250
    begun.send(line, "textmsg(x)")
    begun.rig.tick()
    assert begun.answers == []
    begun.rig.until(lambda: begun.rig.texts == ["750"], 1.0)


def test_cleared_statements_use_no_memory(begun: InterpreterClient) -> None:
    """Cleared statements use no memory, since a program can be in interpreter mode for days."""
    namespace: dict[str, object] = begun.rig.controller.programs.host.runtime._namespace
    begun.ack("def f(a): return textmsg(a) end y = 1 f(2)")
    begun.ack("clear_interpreter()")
    before = set(namespace)
    for number in range(20):
        begun.ack(f"def f{number}(a): return textmsg(a) end y{number} = 1 f{number}(2)")
    begun.ack("clear_interpreter()")
    assert set(namespace) == before
    assert not begun.rig.controller.programs.interpreter.queue.kept
    assert namespace["_locals"] == {}


# garbage

PIECES = st.sampled_from(
    """
    def f():|thread t():|end|if True:|while|x|y|=|1|(|)|f()|run t()|[1,2]|p[|clear_interpreter()|end_interpreter()
    |skipbuffer|abort|global|local|g|.append(1)|sync()|return|break|sleep(0.004)|"|#|interpreter_mode()|1e999
    |movej([0,-1.5,1.5,-1.6,-1.57,0.01])
    """.replace("\n", "").split("|")
)
LINES = st.lists(st.lists(PIECES, max_size=8).map(" ".join) | st.text(max_size=30), max_size=8)


@settings(max_examples=examples(26), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=LINES, ticks=st.integers(0, 3))
def test_garbage(make_rig: Callable[..., Any], lines: list[str], ticks: int, caplog: pytest.LogCaptureFixture) -> None:
    """Every line is eventually answered exactly once, and nothing else breaks."""
    caplog.clear()
    client = InterpreterClient(make_rig("ur5e", None))
    client.begin("global g = 1\nwhile True:\n  interpreter_mode()\nend")
    for line in lines:
        client.send(line)
        client.rig.tick(ticks)
    client.rig.seconds(0.1)
    client.rig.controller.programs.stop()
    client.rig.tick(2)
    assert len(client.answers) == len(lines)
    assert all(answer.split(":")[0] in ("ack", "discard", "state") for answer in client.answers)
    assert not [error for error in client.rig.exceptions if "internal error" in error.text]
    assert not [record for record in caplog.records if record.exc_info], caplog.text


def test_a_line_compiled_in_pieces_continues_after_clearing_itself(client: InterpreterClient) -> None:
    client.begin("global x = 0\ninterpreter_mode()")
    steps = " ".join(f"x = x + {number} y{number % 9} = x if x < 0: sync() end" for number in range(200))
    client.send(f"clear_interpreter() {steps} textmsg(x)")
    client.rig.until(lambda: bool(client.rig.texts), 2.0)
    assert client.rig.texts == [str(sum(range(200)))]
    assert client.rig.exceptions == []
