"""Tests of URScript programs, written in URScript: ``urscript test`` (docs/script_tests.md).

`suite` finds the tests and reads their settings, `program` puts a test and the files that it tests together, `runner`
runs it on a new robot in virtual time, and `assertions` are the functions that tests can call. `coverage` and `profile`
observe a run; `reports` writes the results, and `command` is the command line.
"""
