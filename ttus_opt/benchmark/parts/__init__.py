"""Parts of the benchmark, one file each with a ``PART``."""
