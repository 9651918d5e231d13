"""The benchmark: solvers, assembly, rendering and more, each run in its own process."""

from ttus_opt.benchmark.cases import CaseSpec as CaseSpec
from ttus_opt.benchmark.cases import reference_cases as reference_cases
from ttus_opt.benchmark.row import Row as Row
from ttus_opt.benchmark.row import RunSpec as RunSpec
from ttus_opt.benchmark.row import Settings as Settings
from ttus_opt.benchmark.suite import Suite as Suite
