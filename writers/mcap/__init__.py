"""The MCAP that a run writes."""
