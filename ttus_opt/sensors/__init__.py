"""From the sensors: cameras, markers and trackers, brought into one frame."""
