"""The Rerun recording that a run writes."""
