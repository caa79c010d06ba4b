"""The node ``move_group``: what MoveIt's clients ask of it, answered by `client.planning`.

`node` puts it together. Needs the extra ``plan``. Names, types and codes are those of MoveIt 2; where MoveIt and this
differ, docs/ros2.md says so.
"""
