"""Evaluation of a result: its frames beside the truth, its figures, and requirements on them."""
