"""The method of the solver `structured`: eq. 10 with limits, through its dual.

From top to bottom:

- `active_set` iterates over working sets (`working_set`, `optimality`) of one field
  (`subproblem`, `limits`) or of two (`field_pair`, `pair_subproblem`, `pair_laplace`);
  where possible a model predicts the next one (`soft_values`, `touched_limits`);
- `solver` solves the dual of each, with unknowns beside the field
  (`linear_parameters`), by conjugate gradients with kept directions on the Schur
  complement (`system`), with an approximate one as preconditioner (`preconditioner`);
- `data` extracts the dual from a program; `options` has the numbers of it all.
"""
