"""The toml writer: whatever it writes, a toml reader understands."""

import tomllib

from hypothesis import given
from hypothesis import strategies as st

from rotorid_torch.fly.write import to_toml

values = st.one_of(
    st.integers(-(2**40), 2**40),
    st.floats(allow_nan=False, allow_infinity=False),
    st.booleans(),
    st.text('ab "\\ü\n', max_size=5),
)
tables = st.recursive(
    st.dictionaries(
        st.text("abc_ .", min_size=1, max_size=4), st.one_of(values, st.lists(st.floats(-1e9, 1e9), max_size=3))
    ),
    lambda inner: st.dictionaries(st.sampled_from(["x", "y-1", "a b"]), st.one_of(values, inner), max_size=3),
    max_leaves=6,
)


@given(tables)
def test_round_trip(table):
    """Numbers, strings, lists and tables come back."""
    assert tomllib.loads(to_toml(table)) == table
