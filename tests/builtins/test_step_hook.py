"""The hook for debuggers and tracers: called before each statement, can hold a thread."""

PROGRAM = """
def f():
  def add(n):
    return n + 1
  end
  x = 0
  x = add(x)
  x = add(x)
end
"""


def test_a_thread_can_be_held_at_any_statement_including_inside_functions(rig):
    held = [True]
    seen = []

    def hook(host, line, column, thread):
        seen.append((host.name, line, column, thread.name))
        return held[0] and line == 3

    rig.controller.programs.step_hook = hook
    rig.submit(PROGRAM)
    rig.tick(10)
    assert rig.controller.programs.busy
    assert rig.controller.programs.line == 3
    assert rig.controller.programs.variables["x"] == 0
    assert seen[:2] == [("f", 5, 3, "f"), ("f", 6, 3, "f")]
    assert seen[2:] == [("f", 3, 5, "f")] * (len(seen) - 2)
    held[0] = False
    rig.tick(2)
    rig.tick()
    assert not rig.controller.programs.busy
    assert seen[-2:] == [("f", 7, 3, "f"), ("f", 3, 5, "f")]


def test_programs_submitted_without_a_hook_have_no_steps(rig):
    rig.submit(PROGRAM)
    rig.controller.programs.step_hook = lambda *_: True  # too late: the program was compiled without steps
    rig.tick(5)
    assert not rig.controller.programs.busy
