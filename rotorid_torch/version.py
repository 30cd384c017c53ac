"""Version of the package, in one place: pyproject.toml and whatever is written read it here."""

__version__ = "0.2.0"
