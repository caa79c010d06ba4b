"""The control API: what a test, a tool or the teach pendant does to an emulated robot from behind the scenes.

One set of verbs, `emulator.control.control.Control`, in three forms: a Python object, HTTP/JSON
(`emulator.control.http`), and ``ur-emulator ctl``.
"""
