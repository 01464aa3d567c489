"""How good a result is: its frames beside the truth, the figures that come of it, and what is required of them."""
