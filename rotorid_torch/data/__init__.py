"""Data sets: declared, read, validated once, written.

Read `schema` (what may be declared), `declare` with `refusal` and `plausible` (from text to a declaration, or an error
that names file and key), `flight` and `dataset` (what every step takes), `facts` and `on_demand` (a thousand flights
without their samples in memory), `one_rate` (a data set made of another), `windows` (for a DataLoader), `write`.
`reading/` leads from files to flights, where missing samples become NaN (`Flight.bridged` fills them for who needs it);
`velocities/` makes those that a data set lacks, `use/` leads from flights to pictures and tables.
"""

from rotorid_torch.data.dataset import Dataset as Dataset
from rotorid_torch.data.dataset import load as load
from rotorid_torch.data.flight import Flight as Flight
