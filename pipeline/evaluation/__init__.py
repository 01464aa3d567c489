"""Evaluation of results: detection, tracking and fusion against truth, figures without truth, two runs compared."""
