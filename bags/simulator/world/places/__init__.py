"""What stands still: a model crossing, an urban crossing, a street."""
