"""Results as data sets in the formats of others, to train and label with."""
