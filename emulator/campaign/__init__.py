"""Many runs of programs or tests in virtual time: ``ur-emulator campaign``.

``plan`` determines the runs, each a command line of ``urscript run`` or ``pytest``; ``work`` executes one. ``local``
and ``cluster`` execute runs in processes on this machine, or with Ray. ``conduct`` distributes the runs, ``journal``
stores their results, ``minimise`` simplifies failing runs, ``report`` writes the report, ``command`` is the command
line.
"""

__all__: list[str] = []
