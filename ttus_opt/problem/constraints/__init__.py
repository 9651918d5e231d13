"""Constraints of a problem: one file per member.

`ttus_opt.problem.constraints.Sign` and the like find their file;
``dir(ttus_opt.problem.constraints)`` lists what there is.
"""

from ttus_opt.core.plugins import finders

__getattr__, __dir__ = finders(__name__)
