"""The method of `normal_equations`: conjugate gradients on the normal equations.

From top to bottom:

- `limited_sum` solves the working sets of `dual.active_set`;
- `least_squares` minimises a function of the field;
- `preconditioner` eliminates the few rows through their dual; `approximate_system` is
  one V-cycle each way and includes a root of the wide terms (`matching`);
- `split` sorts the terms.
"""
