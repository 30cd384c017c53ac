"""Work elsewhere: `ranks` share a run, `children` end with this process, `loading` of imports, `memory`, `device`."""
