"""Contact force and torque of a field at the rate of a haptic device."""
