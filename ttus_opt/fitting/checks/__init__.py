"""Checks of recordings: signs, frames, units and readings."""
