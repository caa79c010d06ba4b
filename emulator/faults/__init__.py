"""Faults on demand: of the network, of RTDE, of arm and scene, of programs and of the controller.

A fault is a small frozen dataclass (`emulator.faults.fault`). Each kind is a class, in the module of its subject.
`emulator.faults.catalogue` lists all kinds, `emulator.faults.injector` carries faults out.
"""
