"""The voxel grid of the patient and the potential field on it."""
