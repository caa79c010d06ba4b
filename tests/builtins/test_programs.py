"""Programs as a whole: start, end, replacement, pause, secondary programs, watchdogs, popups."""

import pytest

from emulator.commands.requests import DashboardLine, ScriptUnit
from emulator.lifecycle.power import PowerEvent
from emulator.lifecycle.safety import SafetyEvent
from emulator.programs.loading import ProgramLoadError
from tests.rows import each_row
from urproto.modes import RuntimeState, SafetyMode
from urproto.primary.messages import PopupMessage, RequestValueMessage
from urscript.work import run_to_end


def test_start_and_end_are_reported_once_around_the_text(rig):
    rig.start('textmsg("hello ", 3)', name="greet")
    rig.seconds(0.1)
    kinds = [(m.title, m.text) if hasattr(m, "title") else m.text for m in rig.messages]
    assert kinds == [("PROGRAM_XXX_STARTED", "greet"), "hello 3", ("PROGRAM_XXX_STOPPED", "greet")]
    assert rig.state is RuntimeState.STOPPED


def test_a_bare_line_is_a_separate_program(rig):
    rig.controller.post(ScriptUnit("set_digital_out(2, True)\n", "line"))
    rig.seconds(0.1)
    assert rig.controller.snapshot.actual_digital_output_bits == 0b100
    assert [title for title, _ in rig.keys] == ["PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"]


def test_an_unknown_name_is_reported_with_its_line_and_nothing_starts(rig):
    rig.submit("def illegal_fun():\n  calldoesntexist()\nend\n")
    rig.tick(3)
    (error,) = rig.exceptions
    assert (error.line, error.column, error.text) == (2, 3, "compile_error_name_not_found:calldoesntexist:")
    assert rig.keys == []


def test_a_program_that_does_not_compile_leaves_the_running_one_alone(rig):
    rig.start("while True:\n  sync()\nend", name="keeper")
    rig.tick(3)
    rig.submit("def broken(:\nend\n")
    rig.tick(3)
    assert rig.state is RuntimeState.PLAYING
    assert rig.controller.programs.name == "keeper"
    assert len(rig.exceptions) == 1


def test_a_runtime_error_ends_the_program_after_its_message(rig):
    rig.start("a = [1, 2]\nb = a[5]", name="careless")
    rig.seconds(0.1)
    assert [type(m).__name__ for m in rig.messages] == ["KeyMessage", "RuntimeExceptionMessage", "KeyMessage"]
    assert rig.exceptions[0].line == 3


def test_sockets_close_well_before_the_next_program_starts(rig):
    loop = 'socket_open("10.0.0.1", 50001, "a")\nwhile True:\n  sync()\nend'
    rig.start(loop)
    rig.tick(5)
    rig.start(loop)
    closed = rig.controller.step_count
    assert [socket.state for socket in rig.sockets.opened] == ["closed"]
    rig.until(lambda: len(rig.sockets.opened) == 2, 1.0)
    assert (rig.controller.step_count - closed) * rig.period >= 0.010


def test_halt_ends_all_threads_and_closes_sockets(rig):
    rig.run(
        """
        thread busy():
          while True:
            sync()
          end
        end
        run busy()
        socket_open("10.0.0.1", 50001)
        sleep(0.02)
        halt
        """
    )
    assert [socket.state for socket in rig.sockets.opened] == ["closed"]


def test_a_stopped_program_ends_once_the_arm_is_at_rest(rig):
    rig.start("movej([1, -1.5, 1.5, -1.6, -1.57, 0], a=5, v=2)")
    rig.seconds(0.4)
    assert rig.controller.snapshot.target_qd[0] > 1.0
    rig.controller.programs.stop("test")
    assert rig.state is RuntimeState.STOPPING
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 2.0)
    assert rig.controller.snapshot.target_qd == (0.0,) * 6
    assert rig.q[0] < 0.9


def test_pause_and_resume_stay_on_the_path_and_arrive(rig):
    rig.start("movej([0.5, -1.5, 1.5, -1.6, -1.57, 0])")
    rig.seconds(0.3)
    assert rig.controller.programs.pause()
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 2.0)
    held = rig.q
    rig.seconds(1.0)
    assert rig.q == held
    assert rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.STOPPED)
    assert rig.q[0] == pytest.approx(0.5, abs=1e-9)
    assert [title for title, _ in rig.keys] == [
        f"PROGRAM_XXX_{what}" for what in ("STARTED", "PAUSED", "RESUMED", "STOPPED")
    ]


def test_a_program_without_arm_power_waits_and_the_log_says_for_what(make_rig):
    rig = make_rig("ur5e", None, running=False)
    rig.start('textmsg("no")')
    rig.tick(5)
    assert [title for title, _ in rig.keys] == ["PROGRAM_XXX_STARTED", "PROGRAM_XXX_PAUSED"]
    assert rig.texts == []
    assert any("prog waits: power the arm on" in line for line in rig.controller.messages.history)


def test_a_secondary_program_runs_alongside_the_main_one(rig):
    rig.start("while True:\n  sync()\nend", name="main")
    rig.tick(3)
    rig.submit("sec aside():\n  set_standard_digital_out(1, True)\nend\n")
    rig.tick(2)
    assert rig.controller.signals.digital_outputs == 0b10
    assert rig.controller.programs.name == "main"
    assert rig.keys == [("PROGRAM_XXX_STARTED", "main")]


@pytest.mark.parametrize(
    ("statement", "part"),
    [("sleep(0.5)", "too much behind"), ("movej([0,0,0,0,0,0])", "cannot control the robot"), ('x = to_num("a")', "")],
)
def test_a_failing_secondary_program_leaves_the_main_one_alone(rig, statement, part):
    rig.start("while True:\n  sync()\nend", name="main")
    rig.tick(3)
    rig.submit(f"sec aside():\n  {statement}\nend\n")
    rig.tick(3)
    title, text = rig.keys[-1]
    assert title == "SECONDARY_PROGRAM_EXCEPTION_XXX"
    assert part in text
    assert rig.state is RuntimeState.PLAYING


def test_a_protective_stop_pauses_and_resuming_continues_after_the_call(rig):
    rig.start('protective_stop()\nsync()\ntextmsg("after")')
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 1.0)
    snapshot = rig.controller.snapshot
    assert snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert not rig.controller.programs.resume()
    rig.controller.post(ScriptUnit("set unlock protective stop\n", "line"))
    rig.tick(3)
    assert rig.state is RuntimeState.PAUSED
    rig.controller.programs.resume()
    rig.until(lambda: rig.state is RuntimeState.STOPPED, 1.0)
    assert rig.texts == ["after"]


def test_a_program_consisting_of_a_protective_stop_ends(rig):
    """The official client library waits for the message that it ended."""
    rig.start("protective_stop()")
    rig.tick(5)
    assert rig.state is RuntimeState.STOPPED
    assert rig.controller.snapshot.safety_mode is SafetyMode.PROTECTIVE_STOP
    assert [title for title, _ in rig.keys][-1] == "PROGRAM_XXX_STOPPED"


def test_a_program_moves_after_a_protective_stop_without_program(rig):
    rig.submit("protective_stop()\n")
    rig.tick(5)
    rig.controller.programs.stop()
    rig.seconds(0.1)
    rig.controller.post(ScriptUnit("set unlock protective stop\n", "line"))
    rig.tick(2)
    rig.run("movej([0.2, -1.5, 1.5, -1.6, -1.57, 0])")
    assert rig.q[0] == pytest.approx(0.2)


@pytest.mark.parametrize("model", ["ur3", "ur5e"])
def test_a_secondary_program_opens_a_socket_if_the_answer_comes_within_its_period(make_rig, model):
    """Forum thread 8259: `sec` programs that send "set speed" to the controller's own port, in daily use."""
    rig = make_rig(model, None)
    rig.sockets.listening.add(("10.0.0.1", 30003))
    rig.submit('sec slow():\n  socket_open("10.0.0.1", 30003)\n  socket_send_line("set speed 0.8")\nend\n')
    rig.tick(2)
    assert rig.sockets.opened[-1].sent == b"set speed 0.8\n"
    assert rig.sockets.opened[-1].state == "closed"
    assert rig.keys == []


def test_time_stands_still_for_a_secondary_program_that_connects(rig):
    rig.sockets.silent.add(("10.0.0.1", 9))
    rig.start("i = 0\nwhile True:\n  i = i + 1\n  sync()\nend")
    rig.tick(3)
    rig.submit('sec late():\n  socket_open("10.0.0.1", 9, "own")\n  socket_send_line("here", "own")\nend\n')
    rig.tick(3)
    assert rig.controller.programs.busy
    late = rig.sockets.opened[-1]
    late.accept()
    rig.tick()
    assert late.sent == b"here\n"
    rig.submit('sec never():\n  if not socket_open("10.0.0.1", 9, "two"):\n    textmsg("gave up")\n  end\nend\n')
    rig.until(lambda: "gave up" in rig.texts, 0.2)
    assert rig.state is RuntimeState.PLAYING


def test_watchdog_action_in_capitals(rig):
    """As the program of the vendor's RTDE client writes it."""
    rig.start('rtde_set_watchdog("input_int_register_0", 10, "PAUSE")\nwhile True:\n  sync()\nend')
    rig.until(lambda: rig.state is RuntimeState.PAUSED, 1.0)


@each_row("call", ['"no_such_field", 10', '"input_int_register_0", 10, "explode"', '"input_int_register_0", -1'])
def test_invalid_watchdog_arguments_are_refused(rig, call):
    assert "rtde_set_watchdog" in rig.fault(f"rtde_set_watchdog({call})")


def test_a_blocking_popup_suspends_the_whole_program_until_it_is_closed(rig):
    rig.start(
        """
        thread count():
          while True:
            ticks = ticks + 1
            sync()
          end
        end
        global ticks = 0
        run count()
        popup("Really?", title="Question", blocking=True)
        textmsg("closed")
        sleep(0.1)
        """
    )
    rig.seconds(0.1)
    (shown,) = [m for m in rig.messages if isinstance(m, PopupMessage)]
    assert (shown.title, shown.text, shown.blocking) == ("Question", "Really?", True)
    held = rig.controller.programs.variables["ticks"]
    rig.seconds(0.1)
    assert rig.controller.programs.variables["ticks"] == held
    assert rig.texts == []
    rig.controller.post(DashboardLine("close popup"))
    rig.tick(3)
    assert rig.texts == ["closed"]


def test_a_non_blocking_popup_outlives_the_program(rig):
    rig.run('popup(p[1, 2, 3, 4, 5, 6], "Point")\ntextmsg("on")')
    assert rig.texts == ["on"]
    assert [popup.text for popup in rig.controller.popups.shown] == ["p[1,2,3,4,5,6]"]


def test_a_blocking_popup_closes_with_its_program(rig):
    rig.start('popup("wait", blocking=True)')
    rig.tick(3)
    rig.controller.programs.stop()
    assert rig.controller.popups.shown == []


def test_a_question_to_the_operator_waits_for_its_answer(rig):
    rig.start('textmsg(request_integer_from_primary_client("How many?"))')
    rig.seconds(0.5)
    (message,) = [m for m in rig.messages if isinstance(m, RequestValueMessage)]
    assert message.text == "How many?"
    assert rig.controller.popups.answer(message.request_id, 7)
    rig.tick(3)
    assert rig.texts == ["7"]


def test_only_one_thread_moves_the_robot(rig):
    text = rig.fault(
        """
        thread spin():
          while True:
            speedj([0.1, 0, 0, 0, 0, 0], 1, 0.1)
          end
        end
        run spin()
        sleep(0.1)
        stopj(2)
        """
    )
    assert text == "Another thread is already controlling the robot"


def test_a_killed_thread_releases_the_robot_and_leaves_it_moving(rig):
    rig.run(
        """
        thread go():
          movej([1.5, -1.5, 1.5, -1.6, -1.57, 0], a=2, v=1)
        end
        h = run go()
        sleep(0.8)
        kill h
        global before = get_target_joint_speeds()
        textmsg(before[0] > 0.9)
        stopj(4)
        textmsg(norm(get_target_joint_speeds()))
        """
    )
    assert rig.texts == ["True", "0"]
    assert 0.4 < rig.q[0] < 0.8


def test_a_thread_owns_the_robot_only_while_it_moves(rig):
    rig.run(
        """
        thread first():
          movej([0.2, -1.5, 1.5, -1.6, -1.57, 0])
        end
        h = run first()
        join h
        movej([0, -1.5, 1.5, -1.6, -1.57, 0])
        """
    )
    assert rig.q[0] == pytest.approx(0.0, abs=1e-12)


def test_a_loaded_script_plays_and_its_name_is_reported(rig, tmp_path):
    path = tmp_path / "tool.urp"
    path.write_bytes(b"")
    path.with_suffix(".script").write_text('def tool():\n  textmsg("played")\nend\n')
    run_to_end(rig.controller.programs.load_steps(path))
    assert rig.controller.programs.loaded.path == path
    assert rig.controller.programs.play().accepted
    rig.seconds(0.1)
    assert rig.texts == ["played"]


def test_an_unreadable_program_tree_is_not_loaded_without_its_script(rig, tmp_path):
    path = tmp_path / "bare.urp"
    path.write_bytes(b"")
    with pytest.raises(ProgramLoadError, match=r"bare\.urp"):
        run_to_end(rig.controller.programs.load_steps(path))
    assert rig.controller.programs.loaded is None


def test_run_state_outputs_follow_the_program(rig):
    rig.run(
        """
        set_runstate_standard_digital_output_to_value(0, 3)
        set_runstate_standard_digital_output_to_value(1, 2)
        set_runstate_gp_boolean_output_to_value(5, 2)
        textmsg(get_standard_digital_out(0))
        textmsg(get_standard_digital_out(1))
        """
    )
    assert rig.texts == ["True", "False"]
    rig.tick()
    assert rig.controller.signals.digital_outputs == 0b10
    assert rig.controller.registers.output.get_bit(5)


KINDS = {
    "standard": ("set_runstate_standard_digital_output_to_value(0, {})", lambda c: c.signals.digital_outputs & 1),
    "register": ("set_runstate_gp_boolean_output_to_value(64, {})", lambda c: c.registers.output.get_bit(64)),
    "analog": ("set_runstate_standard_analog_output_to_value(1, {})", lambda c: c.signals.analog_output(1) / 10.0),  # V
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("action", "before", "running", "ended", "failed"),
    [
        (0, 1, 1, 1, 1),
        (1, 1, 1, 0, 0),
        (2, 0, 0, 1, 1),
        (3, 0, 1, 0, 0),
        (4, 1, 1, 1, 0),
        (5, 0, 1, 1, 0),
        (6, 0, 1, 1, 1),
        (7, 1, 0, 0, 0),
    ],
)
def test_each_run_state_action(rig, kind, action, before, running, ended, failed):
    """Levels: as left by the program before the action was set; while it runs; after it ended normally, and by an
    error."""
    call, read = KINDS[kind]
    level = bool(before)
    rig.run(
        f"set_analog_outputdomain(1, 1)\nset_standard_digital_out(0, {level})\nset_standard_analog_out(1, {before})\n"
        f"write_output_boolean_register(64, {level})\n{call.format(action)}\nsleep(0.1)"
    )
    rig.tick()
    assert read(rig.controller) == ended
    rig.start("sleep(0.1)\nx = [1][5]")
    rig.seconds(0.05)
    assert read(rig.controller) == (ended if action in (1, 2) else running)
    rig.until(lambda: bool(rig.exceptions), 2.0)
    rig.tick()
    assert read(rig.controller) == failed


def test_number_registers_follow_the_program_on_cb3(cb3):
    """Script Manual CB3 3.15.4: 1 is 0 while no program runs, 2 is 1, 3 is 1 while one runs and 0 otherwise."""
    cb3.run(
        """
        write_output_integer_register(7, 9)
        write_output_float_register(8, 9)
        set_runstate_gp_integer_output_to_value(7, 1)
        set_runstate_gp_float_output_to_value(8, 2)
        set_runstate_gp_float_output_to_value(9, 3)
        textmsg(read_output_integer_register(7))
        textmsg(read_output_float_register(9))
        """
    )
    assert cb3.texts == ["9", "1"]
    cb3.tick()
    registers = cb3.controller.registers.output
    assert [registers.get_int(7), registers.get_double(8), registers.get_double(9)] == [0, 1.0, 0.0]


def test_outputs_follow_drive_power(make_rig):
    rig = make_rig("ur5e", None, running=False)
    rig.submit(
        "sec s():\n  set_runstate_standard_digital_output_to_value(0, 6)\n"
        "  set_runstate_configurable_digital_output_to_value(0, 7)\nend\n"
    )
    rig.tick(3)
    assert rig.controller.signals.digital_outputs & 0x101 == 0x100
    rig.controller.power.handle(PowerEvent.POWER_ON)
    rig.seconds(5.0)
    assert rig.controller.signals.digital_outputs & 0x101 == 0x001
    rig.controller.power.handle(PowerEvent.POWER_OFF)
    rig.tick()
    assert rig.controller.signals.digital_outputs & 0x101 == 0x100


def test_a_protective_stop_that_ends_a_program_is_an_unscheduled_end(rig):
    rig.start("set_runstate_standard_digital_output_to_value(0, 5)\nwhile True:\n  sync()\nend")
    rig.seconds(0.1)
    assert rig.controller.signals.digital_outputs & 1
    rig.controller.safety_event(SafetyEvent.PROTECTIVE_STOP)
    rig.seconds(0.1)
    rig.controller.programs.stop()
    rig.seconds(0.1)
    assert not rig.controller.signals.digital_outputs & 1


@pytest.mark.parametrize("action", [4, 8, -1])
def test_cb3_has_run_state_actions_up_to_3(cb3, action):
    assert "must be 0 to 3" in cb3.fault(f"set_runstate_standard_digital_output_to_value(0, {action})")


def test_flags_survive_programs(rig):
    rig.run("set_flag(3, True)")
    assert rig.value("get_flag(3)") is True
    assert "no flag 32" in rig.fault("set_flag(32, True)")


def test_a_busy_loop_does_not_delay_the_controller(rig):
    rig.start("while True:\n  x = 1\nend")
    rig.tick(20)
    assert rig.state is RuntimeState.PLAYING
