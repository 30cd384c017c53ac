"""Files and arrays that are whole, checked and bounded.

`atomic` (files whole or absent) and `paths`, `files` (the user's files), `sealed` and `cache` (files of ours, checked
before they are believed), `record` (plain records of a file), `mapped_arrays` (numbers of many flights in a temporary
file), `memory` (a bound on work), `once` (results that last as long as what they belong to).
"""
