import os

# Tests run one process a core, on small problems: more threads of linear algebra only
# wait for each other. Read when numpy is loaded, by whatever comes first.
for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")
