"""Programs, variables and errors of scripts."""

import pytest

from client.pendant.draft import Draft, ScriptError
from client.pendant.programs import Programs
from client.pendant.variables import Variables, VariablesView, format_value, type_name
from tests.rows import each_row
from urproto.primary.messages import (
    NO_TIMESTAMP_US,
    PROGRAM_STARTED,
    PROGRAM_STOPPED,
    KeyMessage,
    ProgramThread,
    ProgramThreadsMessage,
    RuntimeExceptionMessage,
)
from urproto.primary.program_state import GlobalVariableNames, GlobalVariableValues, MatrixValue, PoseValue, Value


def key_message(title: str, name: str, at_s: float = 1.0) -> KeyMessage:
    return KeyMessage(timestamp_us=round(at_s * 1e6), title=title, text=name)


def compile_error(line: int, text: str = "x") -> RuntimeExceptionMessage:
    return RuntimeExceptionMessage(timestamp_us=NO_TIMESTAMP_US, line=line, column=2, text=text)


def runtime_error(line: int) -> RuntimeExceptionMessage:
    return RuntimeExceptionMessage(timestamp_us=5_000_000, line=line, column=2, text="x")


class TestDraft:
    @pytest.fixture
    def draft(self) -> Draft:
        draft = Draft()
        draft.write("def go():\n  sync()\nend\n", "me")
        return draft

    def test_program_is_followed_to_its_end(self, draft: Draft):
        assert draft.prepared_script().text == "def go():\n  sync()\nend\n"
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(key_message(PROGRAM_STOPPED, "go"))  # the previous program of the same name
        phases = [draft.phase]
        for message in (key_message(PROGRAM_STARTED, "other"), key_message(PROGRAM_STARTED, "go")):
            draft.handle_message(message)
            phases.append(draft.phase)
        draft.check_start(100.0)
        draft.handle_message(key_message(PROGRAM_STOPPED, "go"))
        assert [*phases, draft.phase] == ["sent", "sent", "running", "ended"]
        assert draft.error is None

    def test_compile_errors_refer_to_written_line(self):
        draft = Draft()
        draft.write("a = 1\nb = = 2\n")  # bare statements: they get a line before them
        assert draft.prepared_script().text.startswith("def script_")
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(compile_error(3, "syntax_error_on_line:3:b = = 2:"))
        assert draft.phase == "failed"
        assert draft.error is not None
        assert (draft.error.line, draft.error.text[:12]) == (2, "Syntax error")
        draft.mark_sent(draft.prepared_script(), 1.0)
        assert draft.error is None

    def test_errors_of_other_clients_are_ignored(self, draft: Draft):
        draft.handle_message(compile_error(1))
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(runtime_error(2))  # of the previous program
        assert draft.error is None
        draft.handle_message(key_message(PROGRAM_STARTED, "go"))
        draft.handle_message(compile_error(2))  # of another client's script
        assert draft.error is None
        draft.handle_message(runtime_error(2))
        assert draft.phase == "failed"
        draft.handle_message(key_message(PROGRAM_STOPPED, "go"))
        assert draft.phase == "failed"

    def test_script_that_does_not_start_is_reported(self, draft: Draft):
        draft.mark_sent(draft.prepared_script(), 10.0)
        draft.check_start(14.0)
        assert draft.phase == "sent"
        draft.check_start(16.0)
        assert draft.phase == "silent"

    def test_secondary_programs_are_sent_unchanged(self):
        draft = Draft()
        draft.write("sec out():\n  set_digital_out(1, True)\nend\n")
        assert draft.prepared_script().text == draft.text
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(key_message(PROGRAM_STARTED, ""))  # of bare statements that another client sent
        assert draft.phase == "sent"
        draft.check_start(6.0)
        assert draft.phase == "ended"

    def test_empty_or_oversized_text_is_rejected(self, draft: Draft):
        with pytest.raises(ValueError, match="too long"):
            draft.write("x" * 3_000_000)
        assert draft.text.startswith("def go")
        draft.write(" \n")
        with pytest.raises(ValueError, match="no script"):
            draft.mark_sent(draft.prepared_script(), 0.0)

    def test_error_beyond_text_is_marked_at_end(self, draft: Draft):
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(compile_error(99))
        assert draft.error is not None
        assert draft.error.line == 4

    def test_checker_diagnosis_replaces_start_error(self, draft: Draft):
        diagnosis = ScriptError(2, 3, "function 'sinc' is not defined; did you mean 'sync'?")
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(compile_error(2, "compile_error_name_not_found:sinc:"))
        assert [problem.found_by for problem in draft.problems] == ["start"]
        draft.set_diagnoses(draft.revision, (diagnosis,))
        assert draft.problems == (diagnosis,)
        draft.write("def go():\n  sync()\n  a = [1][2]\nend\n")
        draft.set_diagnoses(draft.revision - 1, ())  # of an outdated text
        assert draft.problems == (diagnosis,)
        draft.set_diagnoses(draft.revision, ())
        assert draft.problems == ()

    def test_runtime_error_is_listed_with_diagnoses(self, draft: Draft):
        warning = ScriptError(1, 1, "shadows", severity="warning")
        draft.set_diagnoses(draft.revision, (warning,))
        draft.mark_sent(draft.prepared_script(), 0.0)
        draft.handle_message(key_message(PROGRAM_STARTED, "go"))
        draft.handle_message(runtime_error(2))
        assert [(problem.line, problem.found_by) for problem in draft.problems] == [(2, "run"), (1, "check")]


def test_run_time_is_measured_from_start_to_end():
    programs = Programs()
    assert programs.run_time_s(50.0) is None
    programs.handle_message(key_message(PROGRAM_STARTED, "go", 10.0))
    programs.handle_message(ProgramThreadsMessage(threads=(ProgramThread(3, "Wait", "go"),)))
    assert (programs.running, programs.run_time_s(12.5)) == ("go", 2.5)
    assert programs.threads[0].label == "Wait"
    programs.handle_message(key_message(PROGRAM_STOPPED, "go", 14.0))
    assert (programs.run_time_s(99.0), programs.threads) == (4.0, ())


def report_values(variables: Variables, *values: Value, start: int = 0) -> None:
    variables.handle_message(GlobalVariableValues(start_index=start, values=values))


class TestVariables:
    @pytest.fixture
    def variables(self) -> Variables:
        variables = Variables()
        variables.handle_message(GlobalVariableNames(names=("a", "b", "c")))
        report_values(variables, 1, 2.5)
        return variables

    def test_only_changes_are_sent(self, variables: Variables):
        view = VariablesView(variables)
        assert view.next_update(True) == [["a", "b", "c"], {0: ("int", "1"), 1: ("float", "2.5")}]
        report_values(variables, 1, 2.5)
        assert view.next_update(False) is None
        report_values(variables, 1, 3.5, None)
        assert view.next_update(False) == [None, {1: ("float", "3.5"), 2: ("", "-")}]
        report_values(variables, "late", start=2)
        assert view.next_update(False) == [None, {2: ("string", '"late"')}]

    def test_new_browser_or_program_gets_all_variables(self, variables: Variables):
        view = VariablesView(variables)
        view.next_update(True)
        again = view.next_update(True)
        assert again is not None
        assert again[0] == ["a", "b", "c"]
        variables.handle_message(GlobalVariableNames(names=("x",)))
        assert view.next_update(False) == [["x"], {}]
        report_values(variables)  # as for a program without variables
        assert view.next_update(False) == [[], {}]
        report_values(variables)
        assert view.next_update(False) is None

    @each_row(
        ("value", "kind", "text"),
        [
            (True, "bool", "True"),
            (-3, "int", "-3"),
            (0.10000000149011612, "float", "0.1"),
            ("<b>", "string", '"<b>"'),
            (PoseValue((0.1, -0.25, 0.5, 0, 3.14159, 0)), "pose", "p[0.1000, -0.2500, 0.5000, 0.0000, 3.1416, 0.0000]"),
            ((1, "x", (True,)), "list", '[1, "x", [True]]'),
            (MatrixValue(((1, 2), (3, 4))), "matrix", "[[1, 2], [3, 4]]"),
            (None, "", "-"),
        ],
    )  # fmt: skip
    def test_values_are_formatted_as_in_scripts(self, value: Value, kind: str, text: str):
        assert (type_name(value), format_value(value)) == (kind, text)

    def test_long_value_is_truncated(self):
        assert len(format_value("x" * 5000)) == 400
