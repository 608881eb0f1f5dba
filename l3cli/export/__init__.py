"""Export to other software: profiles of a camera, and a table as C source or as plain arrays."""
