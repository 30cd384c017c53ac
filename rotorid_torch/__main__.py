"""`python -m rotorid_torch`: the same as the console script `rotorid`."""

import sys

from rotorid_torch.cli import main

sys.exit(main())
