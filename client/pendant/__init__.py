"""The teach pendant in a browser: NiceGUI pages over a robot's public ports.

`Station` knows the robot, `Mover` moves it, `Page` is what one browser shows, and each screen is one module in
`client.pendant.screens`. Nothing here needs an emulator; one has a control API, which adds the Simulation screen.
"""
