"""The control API: lets tests, tools and the teach pendant act on an emulated robot and its surroundings.

One set of verbs, `emulator.control.control.Control`, in three forms: a Python object, HTTP/JSON
(`emulator.control.http`), and ``ur-emulator ctl``.
"""
