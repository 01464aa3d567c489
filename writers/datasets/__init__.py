"""Data sets in the layouts of others: one file per format."""
