"""Sensors: one package each, bytes in and samples out, no I/O (see `contract`)."""
