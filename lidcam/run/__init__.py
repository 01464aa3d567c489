"""One run: its job and settings, the frames of a recording, the stages of a frame, tracks, counts."""
