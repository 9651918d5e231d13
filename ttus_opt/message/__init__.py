"""The compact message: a surface, or a field over it, for a thin link."""

from ttus_opt.message.codec import decode, encode

__all__ = ["decode", "encode"]
