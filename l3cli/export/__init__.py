"""Files for other software: camera profiles, C source and arrays of a table."""
