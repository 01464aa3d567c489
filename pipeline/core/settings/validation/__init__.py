"""Settings checked against their models, with mistakes reported in plain words."""
