"""Many recordings: one job each, one process a job, one table of all."""
