"""The probe: its mesh, its point shell, and where it went with what force."""
