"""The structured solver's method: eq. 10 through its dual, within limits.

From top to bottom:

- `primal_dual_active_set` goes from working set to working set (`active_set`,
  `working_set`, `optimality`) of one field (`subproblem`, `limits`) or of two
  (`field_pair`, `pair_subproblem`, `pair_laplace`), to the one that a model predicts
  where there is one (`soft_values`, `touched_limits`);
- `solver` solves the dual of each, with unknowns beside the field
  (`linear_parameters`), by conjugate gradients in a recycled subspace
  (`conjugate_gradients`) on the Schur complement (`system`), preconditioned by an
  approximate one (`preconditioner`);
- `data` reads the dual off a program; `options` has the numbers.
"""
