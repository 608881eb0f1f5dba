"""Draft a measurement file for a folder of captures.

The files are classified by their names and contents. Values that l3 cannot determine are marked for the user.
"""
