"""Parts of `scripts/bench.py`: rows and bars, clocks, and what is measured."""
