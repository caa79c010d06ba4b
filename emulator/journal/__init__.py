"""Journals: every input of a run with its period, so that the run can be replayed bit for bit (docs/journal.md).

`doors` lists the ways by which anything enters a controller. `recorder` writes what enters, `file` is the format,
`values` the form of values in it, and `replay` executes a run again.
"""
