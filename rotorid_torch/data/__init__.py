"""Data sets: read, validated once, written."""
