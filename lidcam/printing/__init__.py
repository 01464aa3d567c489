"""Printing: tables, frames, progress."""
