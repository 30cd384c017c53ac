"""Logs in: readers, maps from log fields to channels, resampling, cutting into manoeuvres."""
