"""The rules. To add one, write a function with ``@body_rule`` or ``@rule`` in one of these modules, and a row of its
test."""

from urscript.check.rules import loops, motion, variables
from urscript.check.rules.registry import RULES

__all__ = ["RULES", "loops", "motion", "variables"]
