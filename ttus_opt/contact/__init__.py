"""Contact of a point shell with the voxmap: rows of forces, torques and friction."""
