"""The paper's experiment as one command: three phantom patients, every error reported.

    from ttus_opt import experiment
    result = experiment.run("results", experiment.Plan(shape=(24, 72, 30)))

Needs scikit-fem (extra ``phantom``) to simulate recordings that are not there yet.
"""

from ttus_opt.experiment.fits import Row
from ttus_opt.experiment.pipeline import n_stages, run
from ttus_opt.experiment.result import ExperimentResult, Plan

__all__ = ["ExperimentResult", "Plan", "Row", "n_stages", "run"]
