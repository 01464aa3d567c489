"""Where the objects of 2D boxes stand, as far as cameras alone can tell."""
