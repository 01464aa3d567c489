"""How good results are: detection, tracking and fusion against truth, figures without truth, comparison of two runs."""
