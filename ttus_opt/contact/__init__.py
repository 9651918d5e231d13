"""Contact of a point shell with the voxmap: rows of force, torque and friction."""
