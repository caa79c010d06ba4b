"""A debugger for URScript, whose time can be turned back.

``debuggee`` runs a program on a robot in virtual time and stops at statements. ``travel`` returns to earlier ones, by
copies of its process. ``adapter`` speaks the Debug Adapter Protocol with editors.
"""
