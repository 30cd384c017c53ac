"""What single commands print or serve.

`console` never obeys what a file says; `doctor`, `effects_table`, `import_log` and `show` are commands.
"""
