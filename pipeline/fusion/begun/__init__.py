"""Objects begun from 2D boxes, and clusters parted by them."""
