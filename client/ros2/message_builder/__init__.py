"""Makes ROS 2 packages of interface definitions: what ament_cmake and rosidl make of them for C and Python, faster.

A process of its own, started by `client.ros2.message_packages`: rosidl's generators write code by the definitions, the
compiler makes libraries of it. The generators are called as rosidl's CMake macros call them. CMake itself would want
packages that PyPI does not have, would generate C++ as well, and would compile every file on its own.

What comes about is an ament prefix: libraries in ``lib``, definitions and type hashes in ``share/<package>``, the ament
index, and Python packages. Its libraries find each other by their own place, so the prefix may be moved.

Reads a plan (`Plan`) as JSON from the standard input. Writes its progress to the standard output, a line
``<part done, 0 to 1> <what is under way>`` each, and what compilers and generators say to the standard error.
"""

from client.ros2.message_builder.packages import KINDS, Plan, python_folder

__all__ = ["KINDS", "Plan", "python_folder"]
