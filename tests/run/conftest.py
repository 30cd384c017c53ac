"""The report that the tests of the report look at, for the tests of runs too."""

from tests.report.conftest import fit as fit
from tests.report.conftest import overlays as overlays
from tests.report.conftest import report as report
