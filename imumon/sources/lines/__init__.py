"""Any sensor that prints numbers, a line for each sample."""
