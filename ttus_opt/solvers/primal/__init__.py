"""Parts of the solver `normal_equations`: any sum of squares beside a Laplace term."""
