"""What is reported: errors, tables and pictures."""
