"""The kept name of `ttus_opt.report.metrics`."""

from ttus_opt.report.metrics import *  # noqa: F403
