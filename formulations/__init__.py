"""Formulations that come with ttus_opt: one file each, found by file name."""
