"""Searches for the schedule of faults, inputs, operators and delays that breaks a program.

``plan`` says what may be chosen and what must hold, ``choices`` what a choice does, ``properties`` whether one holds.
``run`` executes one schedule, ``search`` decides which to try next and simplifies one that breaks a property, and
``answer`` explains it.
"""
