"""Data sets: read, validated once, written."""

from rotorid_torch.data.dataset import Dataset as Dataset
from rotorid_torch.data.dataset import load as load
from rotorid_torch.data.flight import Flight as Flight
