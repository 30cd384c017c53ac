"""The flight-test aircraft: a simulator of its own that flies manoeuvres and writes data sets."""
