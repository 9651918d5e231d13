"""The kept name of `ttus_opt.report.plots`."""

from ttus_opt.report.plots import *  # noqa: F403
