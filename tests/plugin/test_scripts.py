"""Tests in URScript among those of pytest."""

import pytest

SCRIPT = """def test_good():
  sleep(1)
end
def test_bad():
  textmsg("on ", get_controller_model())
  assert_true(False)
end
def get_controller_model():
  return "it"
end
"""


@pytest.mark.parametrize(
    ("options", "outcomes"),
    [
        ((".",), {"passed": 1}),
        ((".", "-o", "ur_script_tests=true"), {"passed": 2, "failed": 1}),
        (("test_cell.script::test_good", "bad_test.script"), {"passed": 1, "errors": 1}),
    ],
)
def test_files_are_collected_on_request(run_tests, pytester, options, outcomes) -> None:
    pytester.path.joinpath("test_cell.script").write_text(SCRIPT)
    pytester.path.joinpath("bad_test.script").write_text("")
    if outcomes.get("errors"):
        pytester.path.joinpath("bad_test.yaml").write_text("program: gone.script")
    result = run_tests("def test_python(): pass", "--continue-on-collection-errors", *options)
    result.assert_outcomes(**outcomes)
    if outcomes.get("failed"):
        result.stdout.fnmatch_lines(["*test_cell.script:6:3: assertion failed: False is not True", "*on it"])
    if outcomes.get("errors"):
        result.stdout.fnmatch_lines(["*there is no file gone.script*"])
