"""Many robots on one machine, each on an address of its own: ``ur-emulator fleet``.

``plan`` says which robots, ``worker`` is a process that runs some of them in one event loop, ``supervisor`` starts
the workers and watches them, ``command`` is the command line.
"""

__all__: list[str] = []
