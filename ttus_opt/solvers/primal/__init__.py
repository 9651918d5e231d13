"""The method of `normal_equations`: conjugate gradients on the normal equations.

From top to bottom:

- `limited_sum` solves the working sets of `dual.active_set`;
- `minimise` minimises a function of the field (`least_squares`);
- `preconditioner` eliminates the few rows through their dual; `approximate_system` is
  one V-cycle each way and includes a root of the wide terms (`matching`);
- `split` sorts the terms.
"""
