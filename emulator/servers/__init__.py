"""The controller's ports: thin asyncio shells around the codecs.

Bytes become commands posted to the controller, snapshots become bytes. No server holds
any state of the robot.
"""
