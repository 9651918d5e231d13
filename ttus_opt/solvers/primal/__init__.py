"""The method of `normal_equations`: conjugate gradients on the normal equations.

From top to bottom:

- `limited_sum` solves working sets of limits (`dual.primal_dual_active_set`);
- `conjugate_gradients` minimises a function of the field (`least_squares`);
- `preconditioner` takes few rows of any weight by their dual, on `approximate_system`:
  one V-cycle each way, with a root of the wide terms (`matching`) in it;
- `split` says what is few and what is wide (`wide_term`); `options` has the numbers.
"""
