"""The teach pendant in a browser: NiceGUI pages over a robot's public ports.

`Station` holds the state of the robot, `Mover` moves it, and `Page` is the page of one browser. Each screen is a module
in `client.pendant.screens`. The pendant does not need an emulator; the control API of one adds the Simulation screen.
"""
