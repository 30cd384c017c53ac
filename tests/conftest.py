"""Settings of the whole test run: one thread, and examples that are the same on every machine and without a clock."""

import hypothesis
import torch

torch.set_num_threads(1)
hypothesis.settings.register_profile("project", derandomize=True, deadline=None, database=None)
hypothesis.settings.register_profile("many", derandomize=False, deadline=None, database=None, max_examples=1000)
hypothesis.settings.load_profile("project")
