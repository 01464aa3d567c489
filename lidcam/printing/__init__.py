"""What the commands print: tables, frames, progress."""
