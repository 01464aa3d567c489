"""Writers of frame results to files."""
