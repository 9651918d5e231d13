"""Laplace's equation in cylindrical coordinates on the voxel grid (eq. 8)."""
