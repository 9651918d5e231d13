"""The command line ``ttus-opt``: one command per file."""

from ttus_opt.cli.app import main as main
