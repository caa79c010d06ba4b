"""Node types of program trees, tested by the behaviour of the robot that plays them."""

import pytest
from tree_rig import Arm, assign, children, expression, installation, line, main, pin, sleep, tag, textmsg

from emulator.reporting.popups import Popup
from urproto.modes import RuntimeState
from urproto.primary.messages import RequestValueMessage
from urproto.signals import STANDARD


@pytest.fixture
def arm(tmp_path):
    return Arm(tmp_path)


def test_the_test_program_of_clients_waits_for_ever(arm):
    arm.start(main(sleep(0.01), once=False))
    arm.seconds(2.0)
    assert arm.state is RuntimeState.PLAYING
    assert arm.request("stop") == "Stopped"


def test_a_program_that_runs_once_ends(arm):
    assert arm.play(sleep(0.5)) == pytest.approx(0.5, abs=0.1)


def test_labels_show_the_current_node(arm):
    arm.start(main(tag("Folder", children(sleep(1.0)), name="cell one"), once=False))
    arm.seconds(0.5)
    view = arm.controller.programs.view
    assert view is not None
    assert [(thread.label_id, thread.label) for thread in view.threads] == [(3, "Wait: 1.0")]


def test_suppressed_nodes_and_placeholders_do_nothing(arm):
    suppressed = tag("SuppressedNode", tag("suppressedNode", class_="Halt"))
    arm.play(suppressed, tag("Placeholder"), tag("Comment", comment="a remark"), textmsg("on"))
    assert arm.texts == ["on"]


def test_expressions_of_characters_tokens_variables_and_inputs(arm):
    variable = tag("ExpressionVariable", tag("ProgramVariable", name="count"))
    io = tag("ExpressionIO", pin("digital_in[2]"))
    token = tag("ExpressionToken", token=" and ")
    equal = tag("ExpressionChar", character="≟")
    one = tag("ExpressionChar", character="1")
    condition = tag("expression", variable, equal, one, token, io, equal, one)
    both = tag("Assignment", tag("variable", name="both"), condition, valueSource="Expression")
    report = line('textmsg("both ", both)')
    arm.play(assign("count", "1"), both, report)
    arm.controller.signals.set_digital_input(STANDARD, 2, True)
    arm.play(assign("count", "1"), both, report, assign("count", "2"), both, report)
    assert arm.texts == ["both False", "both True", "both False"]


def test_symbols_inside_strings_are_unchanged(arm):
    arm.play(line('textmsg("a≟b")'))
    assert arm.texts == ["a≟b"]


def test_names_outside_ascii(arm):
    variable = tag("ExpressionVariable", tag("ProgramVariable", name="größe 1"))
    shown = tag(
        "expression",
        *(tag("ExpressionChar", character=c) for c in 'textmsg("it is ",'),
        variable,
        tag("ExpressionChar", character=")"),
    )
    arm.play(assign("größe 1", "4"), tag("Script", shown, type="Line"))
    assert arm.texts == ["it is 4"]


def test_branches(arm):
    chain = (
        tag("If", expression("n == 1"), children(textmsg("one")), type="If", checkContinuously="false"),
        tag("If", expression("n == 2"), children(textmsg("two")), type="ElseIf", checkContinuously="false"),
        tag("If", expression(""), children(textmsg("more")), type="Else", checkContinuously="false"),
    )
    count = tag(
        "Loop", tag("loopVariable", name="k"), children(assign("n", "k + 1"), *chain), type="Counting", count="3"
    )
    arm.play(count)
    assert arm.texts == ["one", "two", "more"]


def test_a_continuously_checked_branch_is_left_for_the_next(arm):
    arm.play(
        assign("go", "True"),
        tag(
            "If",
            expression("go"),
            children(textmsg("in"), sleep(1.0), textmsg("late")),
            type="If",
            checkContinuously="true",
        ),
        tag("If", expression(""), children(textmsg("else")), type="Else", checkContinuously="false"),
        textmsg("end"),
        others=(tag("Thread", children(sleep(0.5), assign("go", "False")), name="Thread_1", runOnlyOnce="true"),),
    )
    assert arm.texts == ["in", "else", "end"]


def test_a_continuously_checked_branch_runs_while_its_condition_holds(arm):
    arm.play(
        tag("If", expression("True"), children(textmsg("in"), sleep(0.1)), type="If", checkContinuously="true"),
        tag("If", expression("True"), children(textmsg("elif")), type="ElseIf", checkContinuously="true"),
        tag("If", expression(""), children(textmsg("else")), type="Else"),
    )
    assert arm.texts == ["in"]


def test_loops(arm):
    arm.play(
        assign("n", "0"),
        tag("Loop", expression("n < 3"), children(assign("n", "n + 1")), type="While", checkContinuously="false"),
        line('textmsg("n ", n)'),
        tag("Loop", children(sleep(0.1), tag("Halt")), type="Forever"),
        textmsg("never"),
    )
    assert arm.texts == ["n 3"]


def test_a_continuously_checked_loop_is_left_midway(arm):
    took = arm.play(
        assign("go", "True"),
        tag("Loop", expression("go"), children(sleep(5.0)), type="While", checkContinuously="true"),
        others=(tag("Thread", children(sleep(0.5), assign("go", "False")), name="Thread_1", runOnlyOnce="true"),),
    )
    assert took == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize(("value", "texts"), [("1", ["one"]), ("2", ["two"]), ("3", ["other"])])
def test_switch(arm, value, texts):
    cases = (
        tag("Case", children(textmsg("one")), caseValue="1"),
        tag("Case", children(textmsg("two")), caseValue="2"),
        tag("Case", children(textmsg("other")), caseValue="2147483647"),  # the default case (seen)
    )
    arm.play(tag("Switch", expression(value), children(*cases)))
    assert arm.texts == texts


@pytest.mark.parametrize("name", ["digital_in[3]", "Door"])
def test_waiting_for_an_input_of_either_name(arm, name):
    names = tag("IOs", tag("DigitalInputNames", value=", , , Door, , , , "))
    (arm.folder / "cell.installation").write_text(
        '<Installation><T activePose="TCP"><tcp name="TCP" offset="0,0,0,0,0,0"/></T>' + names + "</Installation>"
    )
    wait = tag("Wait", pin(name), tag("digitalValue", "1"), type="DigitalInput")
    arm.start(main(wait, textmsg("open")), installation="cell")
    arm.seconds(0.5)
    assert arm.texts == []
    arm.controller.signals.set_digital_input(STANDARD, 3, True)
    arm.until(lambda: arm.texts == ["open"])


def test_waiting_for_a_condition(arm):
    arm.play(
        assign("n", "0"),
        tag("Wait", expression("n > 2"), type="Condition"),
        textmsg("there"),
        tag("Wait", type="NoWait"),
        others=(tag("Thread", children(assign("n", "n + 1"), sleep(0.1)), name="Thread_1", runOnlyOnce="false"),),
    )
    assert arm.texts == ["there"]


def test_an_event_runs_alongside_the_program_when_its_expression_is_true(arm):
    event = tag("Event", expression("n > 2"), children(textmsg("seen"), assign("n", "0")))
    count = tag(
        "Loop", tag("loopVariable", name="k"), children(assign("n", "n + 1"), sleep(0.1)), type="Counting", count="7"
    )
    arm.play(
        assign("n", "0"),
        count,
        others=(tag("InitVariablesNode", tag("variables", tag("variable", expression("0"), name="n"))), event),
    )
    assert arm.texts == ["seen", "seen"]


def test_of_two_due_events_the_first_runs_first(arm):
    """One chain of if and elif: seen in all eleven public scripts with more than one event."""
    first = tag("Event", expression("n < 3"), children(textmsg("first"), assign("n", "n + 1")))
    second = tag("Event", expression("m < 1"), children(textmsg("second"), assign("m", "m + 1")))
    zero = (tag("variable", expression("0"), name=name) for name in "nm")
    arm.play(sleep(0.5), others=(tag("InitVariablesNode", tag("variables", *zero)), first, second))
    assert arm.texts == ["first", "first", "first", "second"]


def test_setting_outputs(arm):
    arm.start(
        main(
            tag("Set", pin("digital_out[4]"), tag("digitalValue", "1"), type="DigitalOutput"),
            tag("Set", pin("analog_out[1]"), tag("analogValue", "12.0"), type="AnalogOutput"),
            tag("Set", pin("config_out[0]"), expression("1 < 2"), type="ExpressionOutput"),
            sleep(1.0),
        )
    )
    arm.seconds(0.5)
    assert arm.controller.snapshot.actual_digital_output_bits == 0b1_0001_0000
    assert arm.controller.signals.analog_output_ratios[1] == 0.5  # of 4 to 20 mA


def test_payload_by_name_output_pulse_and_voltage(arm):
    """As in a public program of 5.11: 4 V of 10 are 0.4, and the program continues during a pulse."""
    payload = tag(
        "Payload", name="full", mass="2.5", centerOfGravity="0, 0, 0.1", inertiaParameters="0.1, 0.1, 0.1, 0, 0, 0"
    )
    domains = tag("IOs", tag("analogOutputDomain", value="0, 1"))
    (arm.folder / "cell.installation").write_text(installation(tag("PayloadSettings", payload), domains))
    pulse = tag("SingleDigitalPulseActionState", pin("digital_out[3]"), hiPulseInSeconds="0.2")
    arm.start(
        main(
            tag("SetPayload", workpieceName="full"),
            tag("Set", pin("analog_out[1]"), tag("analogValue", "4.0"), type="AnalogOutput"),
            tag("Set", pulse, type="SingleDigitalPulseActionState"),
            line('textmsg("", get_target_payload())'),
            sleep(1.0),
        ),
        installation="cell",
    )
    arm.seconds(0.15)
    assert arm.texts == ["2.5"]
    assert arm.controller.snapshot.actual_digital_output_bits == 0b1000
    assert arm.controller.signals.analog_output_ratios[1] == 0.4
    arm.seconds(0.3)
    assert arm.controller.snapshot.actual_digital_output_bits == 0


def test_a_payload_the_installation_lacks_is_named(arm):
    arm.save("tree.urp", main(tag("SetPayload", workpieceName="gone")))
    assert arm.request("load tree.urp") == "Error while loading program: tree.urp"
    assert "'gone'" in arm.texts[-1]


def test_popups_pause_the_program_and_can_end_it(arm):
    message = tag("Popup", type="Message", haltProgram="false", message='say "hi"', inputType="Text")
    ending = tag("Popup", type="Error", haltProgram="true", message="broken", inputType="Text")
    arm.start(main(message, textmsg("on"), ending, textmsg("never")))
    arm.seconds(0.5)
    shown: list[Popup] = list(arm.controller.popups.shown)
    assert [popup.text for popup in shown] == ["say 'hi'"]
    assert arm.texts == []
    assert arm.request("close popup") == "closing popup"
    arm.until(lambda: arm.state is RuntimeState.STOPPED)
    assert arm.texts == ["on"]


def test_questions_to_the_operator(arm):
    request = tag(
        "Assignment", tag("variable", name="n"), valueSource="Operator", message="How many?", valueType="Integer"
    )
    arm.start(main(request))
    arm.until(lambda: any(isinstance(message, RequestValueMessage) for message in arm.messages))


def test_subprograms_inside_the_program_and_in_separate_files(arm):
    arm.save("parts/pick.urp", main(textmsg("pick")))
    own = tag("subprogram", tag("children", textmsg("place")), name="place it", keepSynchronizedWithDisk="false")
    there = tag(
        "subprogram", tag("programFile", "/programs/parts/pick.urp"), name="pick", keepSynchronizedWithDisk="false"
    )
    kept = tag(
        "subprogram",
        tag("programFile", "/home/ur/ursim/programs/parts/pick.urp"),
        children(textmsg("old copy")),
        name="pick2",
        keepSynchronizedWithDisk="true",
    )
    arm.play(*(tag("CallSubProgram", called) for called in (own, there, kept, own)))
    assert arm.texts == ["place", "pick", "pick", "place"]


def test_a_script_file_and_its_copy(arm):
    (arm.folder / "tools.script").write_text('def tell(n):\n  textmsg("n ", n)\nend\n')
    there = tag("Script", tag("cachedContents", "old copy"), tag("file", "/programs/tools.script"), type="File")
    copy = tag("Script", tag("cachedContents", "tell(2)"), tag("file", "/programs/gone.script"), type="File")
    arm.play(there, line("tell(1)"), copy)
    assert arm.texts == ["n 1", "n 2"]


def test_the_copy_replaces_a_script_saved_with_a_program_of_the_same_name(arm):
    arm.save("tools.urp", main(textmsg("program")))
    (arm.folder / "tools.script").write_text('def tools():\n  textmsg("program")\nend\n')
    arm.play(
        tag("Script", tag("cachedContents", 'textmsg("copy")'), tag("file", "/programs/tools.script"), type="File")
    )
    assert arm.texts == ["copy"]


def test_before_start_runs_once_and_variables_have_initial_values(arm):
    before = tag("SpecialSequence", children(textmsg("before")), type="BeforeStart")
    init = tag("InitVariablesNode", tag("variables", tag("variable", expression("7"), name="n")))
    arm.start(init, before, main(line('textmsg("n ", n)'), sleep(0.5), once=False))
    arm.until(lambda: arm.texts.count("n 7") == 3)
    assert arm.texts[0] == "before"
    assert arm.texts.count("before") == 1


def test_timers_run_while_started(arm):
    def timer(action):
        return tag("Timer", tag("variable", name="t_1"), action=action)

    report = line('textmsg("", t_1)')
    arm.play(timer("Start"), sleep(1.0), timer("Stop"), sleep(1.0), report, timer("Reset"), report)
    assert [float(text) for text in arm.texts] == pytest.approx([1.0, 0.0], abs=0.02)


def test_threads_run_alongside_for_ever(arm):
    thread = tag("Thread", children(textmsg("tick"), sleep(0.2)), name="Thread 1", runOnlyOnce="false")
    arm.play(sleep(0.9), others=(thread,))
    assert arm.texts == ["tick"] * 5
