"""MCAP files: results, and repaired recordings."""
