"""Many runs of programs or tests in virtual time: ``ur-emulator campaign``.

``plan`` says which runs there are, each a command line of ``urscript run`` or ``pytest``; ``work`` carries one out;
``local`` and ``cluster`` are where that happens: processes of this machine, or Ray. ``conduct`` hands the runs out,
``journal`` keeps what came of them, ``minimise`` makes a failing one simpler, ``report`` shows it all to people, and
``command`` is the command line.
"""

__all__: list[str] = []
