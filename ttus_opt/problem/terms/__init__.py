"""Terms of an objective, those of one idea in a file.

Classes are imported on first use, such as `ttus_opt.problem.terms.LaplaceTerm`;
``dir(ttus_opt.problem.terms)`` lists them.
"""

from ttus_opt.core.plugins import finders

__getattr__, __dir__ = finders(__name__)
