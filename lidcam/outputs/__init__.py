"""The outputs of a run: what they may replace, and what writes them."""
