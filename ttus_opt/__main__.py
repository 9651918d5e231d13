"""The command line by ``python -m ttus_opt``."""

from ttus_opt.cli import main

if __name__ == "__main__":
    main()
