"""Rendering: contact force and torque of a field at haptic rate."""
