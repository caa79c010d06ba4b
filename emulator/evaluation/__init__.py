"""``ur-emulator evaluate``: how well a policy solves a task, in episodes with known seeds (docs/evaluation.md).

`play` plays episodes, `evaluate` distributes them to processes and decides when there are enough, and `Report` is what
is known then: the same seeds give the same report, to the byte.
"""
