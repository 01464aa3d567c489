"""The first things that the programs do, before anything heavy is imported."""
