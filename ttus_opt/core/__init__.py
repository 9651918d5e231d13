"""Ground floor: arrays, errors, files, threads, compiled code, plug-ins."""
