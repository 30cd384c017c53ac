"""What single commands print: `console` (never obeys what a file says), `doctor`, `effects_table`, `import_log`."""
