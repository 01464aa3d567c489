"""From frame results to files."""
