import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lidcam.pipeline.tracking.standing import weighted_quantiles


@given(
    values=st.lists(st.floats(-5, 5), min_size=1, max_size=30),
    share=st.sampled_from([0.5, 0.9, 1.0]),
    seed=st.integers(0, 9),
)
def test_quantiles_are_those_of_repeated_values(values: list[float], share: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    groups, repeats = rng.integers(0, 3, len(values)), rng.integers(0, 4, len(values))
    found = weighted_quantiles(np.array(values), repeats.astype(float), groups, 3, share)
    for group in range(3):
        repeated = np.repeat(np.array(values)[groups == group], repeats[groups == group])
        if len(repeated):
            assert found[group] == np.quantile(repeated, share, method="inverted_cdf")
        else:
            assert np.isnan(found[group])
