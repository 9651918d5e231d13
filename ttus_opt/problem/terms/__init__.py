"""Terms of an objective, those of one idea in a file.

Classes are imported on first use, such as `ttus_opt.problem.terms.LaplaceTerm`;
``dir(ttus_opt.problem.terms)`` lists them.
"""

from __future__ import annotations

import sys

from ttus_opt.core import plugins


def __getattr__(name: str) -> type:
    """Find a class in the files of this folder."""
    return plugins.class_of(sys.modules[__name__], name)


def __dir__() -> list[str]:
    """Names of all classes."""
    return sorted(plugins.classes_of(sys.modules[__name__]))
