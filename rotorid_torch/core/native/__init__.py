"""The fast engine: a torch model traced once, written as C++, compiled, and run inside a few generic loops."""
