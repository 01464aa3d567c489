"""What measures: lidars and cameras, their timing and their faults."""
