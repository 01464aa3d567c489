"""The page about a result: one HTML file for people."""
