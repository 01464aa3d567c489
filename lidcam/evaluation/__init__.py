"""How good a result is: its frames beside the truth, the figures that come of it, and the requirements on them."""
