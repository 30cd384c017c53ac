"""Settings of the whole test run: one thread, and examples that are the same on every machine and without a clock."""

from collections import Counter

import hypothesis
import pytest
import torch

torch.set_num_threads(1)
hypothesis.settings.register_profile("project", derandomize=True, deadline=None, database=None)
hypothesis.settings.register_profile("many", derandomize=False, deadline=None, database=None, max_examples=1000)
hypothesis.settings.load_profile("project")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """What was skipped, by reason: nothing is left out in silence."""
    skips = terminalreporter.stats.get("skipped", [])
    reasons = Counter(one.longrepr[2] if isinstance(one.longrepr, tuple) else str(one.longrepr) for one in skips)
    if reasons:
        terminalreporter.section("skipped, by reason")
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count:5}  {reason.removeprefix('Skipped: ')}")
