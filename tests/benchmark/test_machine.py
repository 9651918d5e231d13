"""The machine a table was measured with."""

import numpy as np

from ttus_opt.benchmark.machine import describe


def test_machine_names_what_decides_a_figure():
    facts = describe()
    assert int(facts["cores"]) >= 1
    assert facts["numpy"] == np.__version__
