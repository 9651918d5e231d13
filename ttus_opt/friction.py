"""The kept name of `ttus_opt.contact.friction`."""

from ttus_opt.contact.friction import *  # noqa: F403
