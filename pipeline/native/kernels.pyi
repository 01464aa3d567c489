from lidcam.pipeline.core.arrays import F64, Indices

def columns_of_rows(costs: F64) -> Indices:
    """(R,) the column of each row of costs (R, C), R <= C."""
