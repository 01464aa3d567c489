"""The layout that opens beside a written MCAP in Foxglove and Lichtblick."""
