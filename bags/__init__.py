"""Sample recordings and what records them."""
