"""The node ``move_group``: answers MoveIt's clients with `client.planning`.

`node` assembles it. Needs the extra ``plan``. Names, types and codes are those of MoveIt 2; docs/ros2.md lists where
this node differs from MoveIt.
"""
