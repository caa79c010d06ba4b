"""A Universal Robots controller that is not there.

``emulator.app.Emulator`` is the whole thing with its ports, ``emulator.controller.Controller`` the
controller alone, ticked by the caller in virtual time.
"""

__all__: list[str] = []
