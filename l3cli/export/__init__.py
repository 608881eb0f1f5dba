"""Export camera models as profiles, and transform tables as C source or plain arrays, for other software."""
