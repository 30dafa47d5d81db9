"""What reading a sample returns instead of a decision (streams.py), for callers that do not load numba yet."""

NOTHING = 0
REFUSED = -1
"""A value, or a margin, is not a finite number."""
SEVERAL = -2
"""More than one step is decided."""
FULL = -3
"""There is no room for another sample."""
