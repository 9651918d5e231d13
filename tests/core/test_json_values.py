"""Values as JSON knows them."""

import numpy as np

from ttus_opt.core.json_values import plain


def test_what_json_does_not_know_is_none_and_all_else_stays():
    given = {
        1: [np.nan, np.inf, -0.5, "a word", None, True],
        "in": {"to": (np.int64(3), np.array([1.0, -np.inf]))},
    }
    assert plain(given) == {
        "1": [None, None, -0.5, "a word", None, True],
        "in": {"to": [3, [1.0, None]]},
    }
