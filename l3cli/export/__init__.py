"""Export to other software: camera models as profiles, and transform tables as C source or plain arrays."""
