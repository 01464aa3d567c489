"""What every stage speaks, and the stages: nothing here opens a file of a recording or prints."""
