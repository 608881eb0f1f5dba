"""The report stage: any set of artifacts → one page (`report`)."""
