"""What fusion adds, and how sure that is."""
