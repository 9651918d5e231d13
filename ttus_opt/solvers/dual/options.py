"""The numbers of the method that some problem notices.

`benchmarks/ablation.py` moves each alone, on problems with many active limits, and
prints V-cycles, working sets and KKT residuals.
"""

from __future__ import annotations

#: Most rounds of iterative refinement of a dual: 1 to 20 [–]
REFINEMENTS = 8

#: Largest relative residual of a solve inside a product, up to 1e-3; a hundredth of the
#: dual's own if that is more. At 1e-4, weights of 1e4 and contradictory measurements
#: take more directions [–]
LOOSEST_PRODUCT = 1e-5

#: Most new directions of a dual solve, and most directions of the preconditioner [–]
MAX_DIRECTIONS = 2000

#: Relative residual at which a preconditioner stops: 1e-4 to 0.1 [–]
PRECONDITIONER_RESIDUAL = 0.002

#: Relative error in the energy norm at which it stops too, up to 0.5: the residual may
#: stall in single precision [–]
PRECONDITIONER_ENERGY = 0.01

#: Steps, 1 to 20, over which that error is estimated (Hestenes and Stiefel's rule;
#: Strakoš and Tichý, ETNA 13, 2002) [–]
PRECONDITIONER_DELAY = 4

#: Most working sets [–]
MAX_WORKING_SETS = 100

#: Relative residual of a working set's dual over its worst KKT violation, and at most:
#: 0 to 1, and 1e-6 to 0.1 [–]
SUBPROBLEM_ACCURACY, LOOSEST_SUBPROBLEM = 1e-2, 1e-3

#: Relative residual of the solves for a field, except the last, over its dual's, up to
#: 0.1 [–]
FIELD_ACCURACY = 1e-3

#: Iterations without progress before the safeguard [–]
PATIENCE = 5

#: An order constraint along spokes becomes active if its violation is at least this
#: share, 0.01 to 1, of the worst in its neighbourhood; less if the worst relative
#: violation of all is below a tenth [–]
SHARE = 0.3

#: Number of voxels, 1 to 16, to each side in a neighbourhood [–]
NEIGHBOURHOOD = 4
