"""Errors of tracked poses, estimated from the forces."""
