"""Export to other software: camera models as profiles, and tables as C source or as plain arrays."""
