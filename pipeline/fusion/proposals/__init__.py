"""Objects proposed by 2D boxes."""
