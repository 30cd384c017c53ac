"""`python -m rotorid_torch.trace REQUEST`: a process that draws clean aircraft."""

import sys

from rotorid_torch.core.processes.loading import loading

with loading():
    from rotorid_torch.trace.clean_aircraft import work_on

work_on(sys.argv[1])
