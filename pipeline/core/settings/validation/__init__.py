"""Settings checked against their models: what may be where, and mistakes in plain words."""
