"""What goes wrong on demand: faults of the network, of RTDE, of arm and scene, of programs and of the controller.

A fault is a small frozen dataclass (`emulator.faults.fault`), one class a kind, each in the module of its subject;
`emulator.faults.catalogue` knows them all, `emulator.faults.injector` brings them about.
"""
