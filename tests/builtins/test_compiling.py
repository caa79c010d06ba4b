"""Long scripts are compiled over several control periods; work is counted, not timed."""

from itertools import pairwise

import pytest

from emulator.commands.requests import DashboardLine, ScriptUnit
from emulator.programs import compiling
from emulator.workshare import WORK_PER_SECOND
from urproto.modes import RuntimeState
from urscript.work import run_to_end

BLOCK = '  if a > {n}:\n    a = a - {n}\n    textmsg("{n} ", [a, {n}, 3])\n  end\n'


def long_script(name: str, head: str = "  a = 1\n", blocks: int = 250) -> str:
    """A program that takes many periods to compile; `name` must be new to the cache."""
    return f"def {name}():\n{head}{''.join(BLOCK.format(n=n) for n in range(10, 10 + blocks))}  sync()\nend\n"


def counting(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The cost of each piece of work from now on."""
    prices: list[int] = []
    original = compiling.compile_steps

    def steps(*arguments, **options):
        inner = original(*arguments, **options)
        while True:
            try:
                price = next(inner)
            except StopIteration as end:
                return end.value
            prices.append(price)
            yield price

    monkeypatch.setattr(compiling, "compile_steps", steps)
    return prices


@pytest.mark.parametrize(("model", "period"), [("ur5e", 0.002), ("ur5", 0.008)])
def test_compiling_work_per_period_is_limited(make_rig, monkeypatch, model, period):
    rig = make_rig(model, None)
    share = WORK_PER_SECOND * period
    prices = counting(monkeypatch)
    rig.submit(long_script(f"paced_{model}"))
    done, periods = [sum(prices)], 0
    while rig.state is RuntimeState.STOPPED:
        rig.tick()
        periods += 1
        done.append(sum(prices))
    assert max(prices) < share  # no step is long
    # a step is counted when it is announced, so up to one more than the share is seen in a period
    assert max(b - a for a, b in pairwise(done)) <= share + max(prices)
    assert sum(prices) / share <= periods + 2  # and no period is idle
    assert periods <= 2 + sum(prices) / (share - max(prices))


def test_a_script_always_starts_in_the_same_period(make_rig):
    starts = []
    for _ in range(2):
        rig = make_rig("ur5e", None)
        rig.submit(long_script("same", blocks=200) + f"# {len(starts)}")  # another text, so not in the cache
        rig.until(lambda rig=rig: rig.state is RuntimeState.PLAYING, 1.0)
        starts.append(rig.controller.step_count)
    assert starts[0] == starts[1]
    assert starts[0] > 10


def test_a_cached_script_starts_immediately(rig):
    text = long_script("again")
    rig.submit(text)
    rig.until(lambda: rig.state is RuntimeState.PLAYING, 1.0)
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)
    assert rig.controller.programs.submit(text).accepted
    rig.tick()
    assert rig.state is RuntimeState.PLAYING


def test_the_running_program_continues_while_another_is_compiled_or_refused(rig):
    rig.start("global i = 0\nwhile True:\n  i = i + 1\n  sync()\nend", name="old")
    rig.tick(3)
    refused = rig.controller.programs.submit(long_script("unknown_in_it", head="  a = nobody\n"))
    before = rig.controller.programs.variables["i"]
    assert refused.accepted is None
    rig.until(lambda: refused.accepted is not None, 1.0)
    rig.tick()
    assert refused.accepted is False
    assert [(e.line, e.text) for e in rig.exceptions] == [(2, "compile_error_name_not_found:nobody:")]
    assert rig.state is RuntimeState.PLAYING
    assert rig.controller.programs.variables["i"] > before + 10


def test_submissions_keep_their_order(rig):
    first = rig.controller.programs.submit(long_script("first_long"))
    aside = rig.controller.programs.submit('sec aside():\n  textmsg("aside")\nend\n')
    assert (first.accepted, aside.accepted) == (None, None)
    rig.until(lambda: aside.accepted is not None, 1.0)
    assert first.accepted
    rig.tick(2)
    assert "aside" in rig.texts
    assert rig.keys[0] == ("PROGRAM_XXX_STARTED", "first_long")


def test_stop_drops_the_program_being_compiled_but_not_a_secondary_one(rig):
    programs = rig.controller.programs
    dropped = programs.submit(long_script("dropped"))
    aside = programs.submit('sec beside():\n  textmsg("beside")\nend\n')
    assert programs.stop("test")
    assert dropped.accepted is False
    rig.seconds(0.5)
    assert aside.accepted
    assert rig.texts == ["beside"]
    assert rig.keys == []


def test_input_after_a_script_waits_until_the_script_is_compiled(rig):
    answers = []
    rig.controller.post(ScriptUnit(long_script("awaited"), "block"), answers.append)
    rig.tick(3)
    assert answers == []
    rig.until(lambda: bool(answers), 1.0)
    assert rig.state is RuntimeState.PLAYING


def test_play_answers_when_the_loaded_script_has_started(rig, tmp_path):
    path = tmp_path / "big.script"
    path.write_text(long_script("big"))
    run_to_end(rig.controller.programs.load_steps(path))
    answers = []
    rig.controller.post(DashboardLine("play"), answers.append)
    rig.tick(3)
    assert answers == []
    rig.until(lambda: bool(answers), 1.0)
    assert answers == ["Starting program"]
    assert rig.state is RuntimeState.PLAYING


def test_a_long_thread_is_compiled_in_a_separate_period(rig):
    body = "".join(BLOCK.format(n=n) for n in range(10, 1200))
    submission = rig.controller.programs.submit(f"def outer():\nthread t():\n  local a = 1\n{body}end\nsync()\nend\n")
    rig.until(lambda: submission.accepted is not None, 3.0)
    assert submission.accepted


def test_a_body_compiled_in_pieces_runs_as_one(rig):
    """Lines of errors, returns and loops refer to the whole text, regardless of the piece they are in."""
    loop = "  while a < 40:\n    a = a + 1\n    if a == 30:\n      break\n    end\n  end\n"
    text = long_script("divided", head="  global a = 1\n" + loop, blocks=60)
    text = text.replace("  sync()\nend\n", "  sync()\n  if a > 5:\n    return nothing\n  end\n  b = [1][4]\nend\n")
    rig.submit(text.replace("nothing", "").replace("return \n", "return\n"))
    rig.until(lambda: "a" in rig.controller.programs.variables, 1.0)
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)
    assert rig.exceptions == []
    assert rig.texts == ["10 [20,10,3]", "11 [9,11,3]"]
    rig.submit(text.replace("if a > 5", "if a > 500").replace("return nothing", "return"))
    rig.until(lambda: bool(rig.exceptions), 1.0)
    assert rig.exceptions[0].line == text[: text.index("b = [1]")].count("\n") + 1
