"""Many robots on one machine, each on its own address: ``ur-emulator fleet``.

``plan`` determines the robots, ``worker`` is a process that runs some of them in one event loop, ``supervisor`` starts
and watches the workers, ``command`` is the command line.
"""

__all__: list[str] = []
