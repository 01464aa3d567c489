"""The static worlds: a model crossing, an urban crossing, a street."""
