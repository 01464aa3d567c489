"""Checks of a run: each looks on at the frames and warns of a result that is empty, partial or doubtful."""
