"""Work elsewhere: `ranks` share a run, `children` end with this process, `loading` is of imports, `device`."""
