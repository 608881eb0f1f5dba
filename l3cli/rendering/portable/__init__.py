"""Transform tables for where Python and OpenCL are not: C99 source (`source`), and plain arrays (`arrays`).

c/ holds the C as it is exported, in pieces that `source` joins: what it computes stands there once, and is held to the
reference renderer by tests. What differs from table to table is data: the macros of l3_table.h, the arrays of l3_table.c.
"""
