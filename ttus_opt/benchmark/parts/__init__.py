"""Parts of the benchmark beside the solvers, one file each with a ``PART``."""
