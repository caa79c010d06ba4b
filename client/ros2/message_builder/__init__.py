"""Builds ROS 2 packages of interface definitions, for C and Python, as ament_cmake and rosidl do, but faster.

This runs as a separate process, which `client.ros2.message_packages` starts. rosidl's generators write code from the
definitions, and a compiler builds libraries from it. The generators are called as rosidl's CMake macros call them.
CMake itself would need packages that are not on PyPI, generate C++ too, and compile every file separately. Here, each
library is one translation unit, without optimisation.

A package is recorded when it is complete: a build that was interrupted resumes with the next one.

The result is an ament prefix: libraries in ``lib``, definitions and type hashes in ``share/<package>``, the ament
index, and Python packages. Its libraries find each other by relative paths, so the prefix can be moved.

Reads a plan (`BuildPlan`) as JSON from standard input. Writes its progress to standard output, as lines of the form
``<share done, 0 to 1> <current activity>``, and the output of compilers and generators to standard error.
"""

from client.ros2.message_builder.packages import KINDS, BuildPlan, is_complete, python_folder

__all__ = ["KINDS", "BuildPlan", "is_complete", "python_folder"]
