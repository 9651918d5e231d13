"""From a recording folder to a field, fitted and judged (docs/how-to/session.md).

import ttus_opt as tt
result = tt.run_session("recording", "results")
"""

from ttus_opt.session.pipeline import SessionResult, run_session

__all__ = ["SessionResult", "run_session"]
